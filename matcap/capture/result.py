"""What a capture hands on."""

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
    """How fine-tuning of the paper's decoder went.

    Attributes:
        history: (seconds, step, error) of fine-tuning.
        self_difference: error between neighbouring windows of the photograph; NaN if it has none.
    """

    history: tuple[tuple[float, int, float], ...]
    self_difference: float = math.nan

    @property
    def relative_error(self) -> float | None:
        """Last error over the self difference; None without fine-tuning."""
        if not self.history or not self.self_difference > 0.0:
            return None
        return self.history[-1][2] / self.self_difference


@dataclass(frozen=True)
class CaptureResult:
    """A material and how it came about.

    Attributes:
        photo: what was captured; the first one of several.
        material: endless.
        rectified: (H, W, 3) the photograph on the plane's grid, linear.
        rerendered: (H, W, 3) the material under the photograph's own flash, linear.
        maps: of that same rectangle.
        measurements: differences between photograph and re-rendering.
        verdict: rating, with its sentence and causes.
        stage_seconds: of each stage.
        settings: as given.
        interrupted: ended by Ctrl-C, with the best so far.
        estimate: the photographed piece; None where only a decoder was asked for.
        tuning: of the decoder, where one was asked for.
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
        """That the material was made of."""
        return self.measurements.causes.photographs

    @property
    def effort(self) -> Effort:
        """What the settings came to."""
        return resolve(self.settings, photographs=self.photographs)

    @property
    def tilt_sources(self) -> Mapping[str, Any] | None:
        """Degrees: what was used, what the branch and what the picture says (capture/tilt.py)."""
        coarse: Mapping[str, Any] = self.material.provenance.get("coarse", {})
        return coarse.get("tilt_degrees")

    @property
    def errors(self) -> dict[str, float | None]:
        """`piece`: median difference of log radiance between photograph and re-rendered piece;
        `field`: difference of texture between photograph and the endless material, in multiples
        of what the photograph's own parts differ by. None where there is none.
        """
        field = self.measurements.texture
        return {
            "piece": None if self.estimate is None else self.estimate.error,
            "field": field if math.isfinite(field) else None,
        }
