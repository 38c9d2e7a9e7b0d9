"""Last stages of every capture: re-rendering, measurements and verdict."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.capture.detail import Rectified
from matcap.capture.piece.find import ExemplarEstimate, map_set_of
from matcap.capture.progress import CaptureClock
from matcap.capture.result import CaptureResult, Tuning
from matcap.capture.settings import CaptureSettings, Effort
from matcap.capture.tilt import tilt_document
from matcap.capture.verdict.judge import judge
from matcap.capture.verdict.measurements import ExemplarMeasurements, measured
from matcap.capture.verdict.residue import highlight_residue
from matcap.capture.verdict.steepness import steepness
from matcap.field.material import Material
from matcap.files.interrupts import postponed
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.rectify import picture_of
from matcap.flash.render import render_rectified
from matcap.photo.orient import quarter_turn, standing
from matcap.photo.photo import Photo
from matcap.statistics.lattice import Wave


def judged(
    photo: Photo,
    material: Material,
    rectified: Rectified,
    settings: CaptureSettings,
    clock: CaptureClock,
    estimate: ExemplarEstimate | None = None,
    tuning: Tuning | None = None,
) -> CaptureResult:
    """Re-render a material under its photograph's flash, measure the differences and rate them.

    This is the stage `verdict`, the last before writing.

    Args:
        photo: the photograph, linear.
        material: what was captured.
        rectified: the photograph on the sample's plane.
        settings: of the user.
        clock: of the capture.
        estimate: the exemplar, if one was estimated; upright, as the material is if it is turned.
        tuning: the course of fine-tuning, if a decoder was.
    """
    plane, waves, turned = rectified.whole, rectified.waves, material.setup.turned
    interrupted = clock.interrupted or (estimate is not None and estimate.interrupted)
    with clock.stage("verdict"), postponed() as stopped:
        maps = material.maps(*(plane.size[::-1] if turned else plane.size), seed=settings.seed)
        with torch.inference_mode():
            rerendered = picture_of(render_rectified(maps, material.setup))
        # Pictures are measured as the photograph lies.
        lying = np.ascontiguousarray(quarter_turn(rerendered)) if turned else rerendered
        seen = compared = picture_of(plane.linear)
        if plane.left_out is not None:
            left_out = plane.left_out.numpy()[..., None]
            compared = np.where(left_out, lying, seen)  # a difference of zero
            seen = np.where(left_out, np.float32(0.0), seen)
        drawn = None if tuning is None else maps
        about = None
        if estimate is not None:
            about = _exemplar_measurements(estimate, photo, material, waves, drawn)
        valid = plane.valid.numpy()
        setup = replace(material.setup, turned=False)
        measurements = measured(photo, setup, compared, lying, valid, waves, about)
        verdict = judge(measurements)
    return CaptureResult(
        photo=photo,
        material=material,
        rectified=standing(seen) if turned else seen,
        rerendered=rerendered,
        maps=maps,
        measurements=measurements,
        verdict=verdict,
        stage_seconds=clock.seconds,
        settings=settings,
        interrupted=interrupted or stopped(),
        estimate=estimate,
        tuning=tuning,
    )


def provenance(
    photo: Photo,
    settings: CaptureSettings,
    coarse: CoarseFit,
    effort: Effort,
    joined: list[dict[str, Any]],
) -> dict[str, Any]:
    """JSON record of how a material was made: photographs, settings, steps and coarse fit."""
    document: dict[str, Any] = {
        "photograph": photo.name,
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


def _exemplar_measurements(
    estimate: ExemplarEstimate,
    photo: Photo,
    material: Material,
    waves: tuple[Wave, ...],
    drawn: MapSet | None,
) -> ExemplarMeasurements:
    """Measurements on an exemplar for its verdict; `drawn` are a decoder's maps."""
    confidence = estimate.mean_confidence(photo.kept_share)
    return ExemplarMeasurements(
        maps={"error": estimate.error, "slow": estimate.slow, **confidence},
        residue=highlight_residue(estimate.framed, material.setup),
        tilt=_mean_tilt(estimate),
        steepness=math.nan if drawn is None else steepness(drawn, map_set_of(estimate.framed)),
        # Of a lattice, whole periods are rearranged, however small they are.
        variety=1.0 if waves else estimate.example.variety,
        photographs=1 if estimate.several is None else len(estimate.several.views),
    )


def _mean_tilt(estimate: ExemplarEstimate) -> float:
    """Mean angle between the exemplar's normals and the plane's, degrees."""
    upright = map_set_of(estimate.exemplar).normal[2].clamp(-1.0, 1.0)
    return float(upright.acos().rad2deg().mean())
