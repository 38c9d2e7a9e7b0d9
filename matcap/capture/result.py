"""Stage verdict: a material re-rendered, compared with its photograph and rated; the result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import ExemplarEstimate
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.inspection import checked
from matcap.capture.multiview.set_report import SetReport
from matcap.capture.rectified import Rectified, tilt_document
from matcap.capture.settings import CaptureClock, CaptureSettings, Effort, RunStatus, resolve
from matcap.capture.verdict.causes import ExemplarMeasurements
from matcap.capture.verdict.judge import CaptureVerdict, judge
from matcap.capture.verdict.measurements import (
    Measurements,
    Picture,
    clipped_at,
    lit_from_sides,
    measure_capture,
    patchiness,
)
from matcap.field.material import Material
from matcap.field.source import Generator
from matcap.files.threads import at_once, one_thread
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import render_rectified
from matcap.flash.rectify import picture_of
from matcap.photo.photo import Photo, quarter_turn, standing


@dataclass(frozen=True)
class Tuning:
    """Course of fine-tuning of the paper's decoder."""

    history: tuple[tuple[float, int, float], ...]
    """(seconds, step, error) of fine-tuning."""
    self_difference: float = math.nan
    """Texture distance between neighbouring windows of the photograph, in the units of error; NaN
    if it is too small for two windows."""
    drawing: bool = False
    """Whether the decoder reads a drawing."""

    @property
    def relative_error(self) -> float | None:
        """Last error / self_difference; None without fine-tuning."""
        if not self.history or not self.self_difference > 0.0:
            return None
        return self.history[-1][2] / self.self_difference


@dataclass(frozen=True)
class GeneratorChoice:
    """The generator that makes a material's maps, of two, by measures (by_decoder.py)."""

    generator: Generator
    """The decoder where its distance is less by a fifth, else the exemplar."""
    distances: Mapping[Generator, float]
    """Texture distance to the photograph, by generator: the lesser is nearer."""
    decoded: MapSet
    """Maps of the decoder's field, as large as the photograph."""

    def sentence(self) -> str:
        """Which makes the maps, and both distances."""
        one, other = (self.distances[name] for name in ("example", "decoder"))
        return (
            f"Maps are by default made by the {self.generator}: texture distances to the "
            f"photograph are {one:.2f} by example and {other:.2f} by the decoder, which must be "
            "less by a fifth."
        )

    def document(self) -> dict[str, Any]:
        """The choice for JSON."""
        return {"generator": self.generator, "distances": dict(self.distances)}


@dataclass(frozen=True)
class CaptureResult:
    """Result of a capture."""

    photo: Photo
    """The photograph; the first one of several."""
    material: Material
    """The endless material."""
    rectified: NDArray[np.float32]
    """(H, W, 3) the photograph on the plane's grid, linear."""
    rerendered: NDArray[np.float32]
    """(H, W, 3) `maps` under the photograph's own flash, linear."""
    maps: MapSet
    """(H, W) texels of the material, as many as the photograph has."""
    measurements: Measurements
    """Differences between `rectified` and `rerendered`."""
    verdict: CaptureVerdict
    """Rating, with its sentence and causes."""
    stage_seconds: Mapping[str, float]
    """Duration by stage."""
    settings: CaptureSettings
    """Settings of the user."""
    status: RunStatus
    """How it ended."""
    estimate: ExemplarEstimate | None = None
    """The exemplar; None with a decoder without drawing or `aligned`."""
    tuning: Tuning | None = None
    """Course of fine-tuning; None without a decoder."""
    choice: GeneratorChoice | None = None
    """Choice between two generators; None with one."""

    @property
    def photographs(self) -> int:
        """Number of photographs that the material was made from."""
        return self.measurements.photographs

    @property
    def several(self) -> SetReport | None:
        """Report on several photographs; None for one."""
        return None if self.estimate is None else self.estimate.several

    @property
    def effort(self) -> Effort:
        """Effort that the settings resolve to; without steps where none was taken."""
        effort = resolve(self.settings)
        alone = self.tuning is None and self.settings.generator is None
        return replace(effort, steps=0) if alone else effort

    @property
    def tilt_sources(self) -> Mapping[str, Any] | None:
        """Tilt used and its estimates by source, degrees (rectified.py); None if unmeasured."""
        coarse: Mapping[str, Any] = self.material.provenance.get("coarse", {})
        return coarse.get("tilt_degrees")

    @property
    def errors(self) -> dict[str, float | None]:
        """Errors of exemplar and material, each None where it is not measured.

        `exemplar`: median |log radiance of photograph - of re-rendered exemplar|.
        `field`: texture distance between photograph and material over that between parts of the
        photograph.
        """
        field = self.measurements.texture
        return {
            "exemplar": None if self.estimate is None else self.estimate.error,
            "field": field if math.isfinite(field) else None,
        }


@one_thread()
def judge_material(
    rectified: Rectified,
    material: Material,
    settings: CaptureSettings,
    clock: CaptureClock,
    estimate: ExemplarEstimate | None = None,
    tuning: Tuning | None = None,
) -> CaptureResult:
    """Re-render a material under its photograph's flash, measure the differences and rate them.

    Args:
        material: what was captured.
        estimate: the exemplar, if one was estimated; upright, as the material is if it is turned.
        tuning: the course of fine-tuning, if a decoder was.
    """
    photo, plane, turned = rectified.photo, rectified.whole, material.setup.turned
    with clock.completed("verdict"):

        def shown() -> tuple[MapSet, Picture]:
            size = plane.size[::-1] if turned else plane.size
            maps = material.maps(*size, seed=settings.seed)
            return maps, _rendered(maps, material.setup)

        def measured() -> ExemplarMeasurements | None:
            seed = settings.seed if tuning is None else None
            if estimate is None:
                return None
            return ExemplarMeasurements.of(estimate, rectified, material.setup, seed)

        (maps, landscape), inspected, about = at_once(
            shown, partial(checked, photo, rectified.coarse, plane), measured
        )
        seen, valid = picture_of(plane.linear), plane.valid.numpy()
        hidden = ~plane.kept.numpy()
        seen[hidden] = landscape[hidden]  # a difference of zero where masked
        setup = replace(material.setup, turned=False)
        measurements = measure_capture(
            photo, setup, seen, landscape, valid, rectified.waves, about, inspected
        )
        others = material.provenance.get("others", ())
        measurements = replace(measurements, photographs=1 + len(others))
        itself = map_set_of(estimate.first_rectangle) if estimate and tuning is None else None
        measurements, verdict = _judged(
            measurements, photo, (seen, valid), (maps, itself), material.setup
        )
        seen[hidden] = 0.0
    return CaptureResult(
        photo=photo,
        material=material,
        rectified=standing(seen) if turned else seen,
        rerendered=standing(landscape) if turned else landscape,
        maps=maps,
        measurements=measurements,
        verdict=verdict,
        stage_seconds=clock.seconds,
        settings=settings,
        status=clock.status,
        estimate=estimate,
        tuning=tuning,
    )


def _rendered(maps: MapSet, setup: FlashSetup) -> Picture:
    """(H, W, 3) maps under the flash of their photograph, in landscape format, to be measured."""
    with torch.inference_mode():
        picture = picture_of(render_rectified(maps, setup))
    return np.ascontiguousarray(quarter_turn(picture)) if setup.turned else picture


def _judged(
    measured: Measurements,
    photo: Photo,
    observed: tuple[Picture, NDArray[np.bool_]],
    maps: tuple[MapSet, MapSet | None],
    setup: FlashSetup,
) -> tuple[Measurements, CaptureVerdict]:
    """The verdict, and measurements with those of maps lit from the sides.

    Args:
        measured: of the field.
        observed: the photograph (H, W, 3), linear, and which texels (H, W) of it are valid.
        maps: the field's; and the exemplar's, which tell what of a fault is of its rearrangement.
    """
    (pixels, valid), (field, exemplar) = observed, maps
    if exemplar is None or exemplar.size != field.size:  # of several photographs it may be smaller
        return measured, judge(measured)

    def log_patches(of: MapSet) -> float:
        lit = [patchiness(picture) for picture in lit_from_sides(of, setup)]
        return float(np.log(np.maximum(lit, 1e-6)).mean())

    ours, own = at_once(partial(log_patches, field), partial(log_patches, exemplar))
    measured = replace(measured, patches=math.exp(ours - own))
    verdict = judge(measured)
    if not verdict.asks_for_exemplar:
        return measured, verdict
    rendered = _rendered(exemplar, setup)
    pictures = clipped_at(pixels, photo.headroom), clipped_at(rendered, photo.headroom)
    measured = replace(measured, itself=measured.of_texture(photo, pictures, valid))
    return measured, judge(measured)


def provenance(
    rectified: Rectified, settings: CaptureSettings, effort: Effort, joined: list[dict[str, Any]]
) -> dict[str, Any]:
    """JSON record of how a material was made: photographs, settings, steps and coarse fit.

    `joined` has an entry for each photograph but the first.
    """
    coarse = rectified.coarse
    document: dict[str, Any] = {
        "photograph": rectified.photo.name,
        "settings": settings.named(),
        "millimetres_per_unit": settings.millimetres_per_unit,
        "steps": effort.steps,
        "coarse": {
            "diffuse": list(coarse.diffuse),
            "specular": coarse.specular,
            "roughness": coarse.roughness,
            "residual": coarse.residual,
            "tone_exponent": coarse.tone.exponent,
            "tilt_degrees": tilt_document(coarse),
        },
    }
    return document | ({"others": joined} if joined else {})
