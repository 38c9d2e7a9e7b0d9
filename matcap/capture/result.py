"""Result of a capture: material, re-rendering, measurements and verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.capture.piece.find import ExemplarEstimate
from matcap.capture.settings import CaptureSettings, Effort, resolve
from matcap.capture.verdict.judge import CaptureVerdict
from matcap.capture.verdict.measurements import Measurements
from matcap.field.material import Material
from matcap.photo.photo import Photo


@dataclass(frozen=True)
class Tuning:
    """Course of fine-tuning of the paper's decoder.

    Attributes:
        history: (seconds, step, error) of fine-tuning.
        self_difference: texture distance between neighbouring windows of the photograph, in the
            units of error; NaN if it is too small for two windows.
        drawing: whether the decoder reads a drawing.
    """

    history: tuple[tuple[float, int, float], ...]
    self_difference: float = math.nan
    drawing: bool = False

    @property
    def relative_error(self) -> float | None:
        """Last error / self_difference; None without fine-tuning."""
        if not self.history or not self.self_difference > 0.0:
            return None
        return self.history[-1][2] / self.self_difference


@dataclass(frozen=True)
class CaptureResult:
    """Result of a capture.

    Attributes:
        photo: the photograph; the first one of several.
        material: the endless material.
        rectified: (H, W, 3) the photograph on the plane's grid, linear.
        rerendered: (H, W, 3) `maps` under the photograph's own flash, linear.
        maps: (H, W) texels of the material, as many as the photograph has.
        measurements: differences between `rectified` and `rerendered`.
        verdict: rating, with its sentence and causes.
        stage_seconds: duration by stage.
        settings: of the user.
        interrupted: whether Ctrl-C ended it early, with the best result so far.
        estimate: the exemplar; None with a decoder without drawing or `aligned`.
        tuning: course of fine-tuning; None without a decoder.
    """

    photo: Photo
    material: Material
    rectified: NDArray[np.float32]
    rerendered: NDArray[np.float32]
    maps: MapSet
    measurements: Measurements
    verdict: CaptureVerdict
    stage_seconds: Mapping[str, float]
    settings: CaptureSettings
    interrupted: bool
    estimate: ExemplarEstimate | None = None
    tuning: Tuning | None = None

    @property
    def photographs(self) -> int:
        """Number of photographs that the material was made from."""
        return self.measurements.causes.photographs

    @property
    def effort(self) -> Effort:
        """Effort that the settings resolve to."""
        return resolve(self.settings)

    @property
    def tilt_sources(self) -> Mapping[str, Any] | None:
        """Tilt used and its estimates by source, degrees (capture/tilt.py); None if unmeasured."""
        coarse: Mapping[str, Any] = self.material.provenance.get("coarse", {})
        return coarse.get("tilt_degrees")

    @property
    def errors(self) -> dict[str, float | None]:
        """Errors of exemplar and material, each None where it is not measured.

        `piece`: median |log radiance of photograph - of re-rendered exemplar|.
        `field`: texture distance between photograph and material over that between parts of the
        photograph.
        """
        field = self.measurements.texture
        return {
            "piece": None if self.estimate is None else self.estimate.error,
            "field": field if math.isfinite(field) else None,
        }
