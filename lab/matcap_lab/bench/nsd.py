"""`matcap-lab bench floors`: style distances of captures of known materials.

A sample of a material is photographed and captured. The photograph as albedo, the estimated
exemplar and the field synthesised from it are relit and compared with other true samples:
normalised style distance (measures/nsd.py). Also statistics of the maps and of the truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from matcap.capture.exemplar.estimate import map_set_of
from matcap.capture.pipeline import capture_file
from matcap.capture.result import CaptureResult
from matcap.capture.settings import CaptureSettings
from matcap.flash.geometry import flash_mirror_point
from matcap_lab.bench.methods import CapturedMaps, exemplar_maps, field_maps, photo_as_albedo
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap_lab.measures.lights import highlight_contrast, imprint, mirrored_scene
from matcap_lab.measures.maps import compared_numbers
from matcap_lab.simulate.photograph import Shot, as_photo
from matcap_lab.simulate.specimen import Specimen, photograph

ABOUT = (
    "NSD: normalised style distance by SqueezeNet under new lights; 1 is indistinguishable from "
    "another sample (matcap_lab/measures/nsd.py). Tilt: mean, degrees; albedo: standard deviation "
    "of its logarithm; roughness: mean; each with that of true samples. NSD mirrored: under five "
    "lights whose mirror images are in the picture; highlight: contrast under them, estimated over "
    "true; imprint: of the flash, by map, 0 is none (matcap_lab/measures/lights.py)."
)
ALBEDO, EXEMPLAR, FIELD = "photograph as albedo", "exemplar", "field"


@dataclass(frozen=True)
class PhotographSettings:
    """Settings of photographs and captures."""

    captured: CaptureSettings = field(default_factory=CaptureSettings)
    """Settings of the captures; their `detail` is the exemplar's resolution."""

    ev: float = 0.0
    """Exposure offset from the automatic exposure, EV."""

    jpeg: bool = False
    """JPEGs, instead of RAW."""


@dataclass(frozen=True)
class CapturedSubject:
    """A material, its photograph, the captured maps, and the reference they are compared with."""

    subject: Specimen
    shot: Shot
    result: CaptureResult
    evaluator: Evaluator


def nsd_experiment(
    subjects: Sequence[Specimen],
    out: Path,
    settings: PhotographSettings,
    evaluation: EvaluationSettings,
) -> Experiment[CapturedSubject, CapturedMaps]:
    """Photograph and capture each subject once; evaluate photograph, exemplar and field."""
    style = evaluation.squeezenet

    def prepare(subject: Specimen) -> CapturedSubject:
        path, shot = photograph(subject, evaluation.camera, out, ev=settings.ev, jpeg=settings.jpeg)
        result = capture_file(path, settings.captured)
        evaluator = Evaluator(subject, shot.setup, evaluation, {"NSD": style})
        return CapturedSubject(subject, shot, result, evaluator)

    def albedo(captured: CapturedSubject, _seed: int) -> CapturedMaps:
        photo = as_photo(captured.shot, captured.subject.seed, captured.subject.name)
        return photo_as_albedo(photo, captured.shot.setup, evaluation.detail)

    return Experiment(
        "floors",
        {subject.name: partial(prepare, subject) for subject in subjects},
        {
            ALBEDO: Configuration(albedo),
            EXEMPLAR: Configuration(lambda captured, _seed: exemplar_maps(captured.result)),
            FIELD: Configuration(
                lambda captured, seed: field_maps(captured.result.material, evaluation.width, seed)
            ),
        },
        (nsd, under_mirrored_lights, flash_imprint, map_numbers),
        settings=(settings, evaluation),
    )


def nsd(captured: CapturedSubject, maps: CapturedMaps) -> Mapping[str, Value]:
    """Normalised style distance."""
    return {"NSD": captured.evaluator.style_ratio_of(maps.maps, maps.setup.intensity)}


def under_mirrored_lights(captured: CapturedSubject, maps: CapturedMaps) -> Mapping[str, Value]:
    """NSD and highlight contrast under mirrored lights, the latter estimated over true."""
    evaluator, scene = captured.evaluator, mirrored_scene(captured.evaluator.flash)
    middle = evaluator.middle(maps.maps)
    true = [math.log(highlight_contrast(one, scene)) for one in evaluator.truths]
    log_contrast = math.log(highlight_contrast(middle, scene))
    pictures = evaluator.relit(middle, maps.setup.intensity, scene)
    return {
        "NSD mirrored": evaluator.style_ratio(pictures, scene=scene),
        "highlight": math.exp(log_contrast - sum(true) / len(true)),
    }


def flash_imprint(captured: CapturedSubject, maps: CapturedMaps) -> Mapping[str, Value]:
    """Highlight residue of each map, in [-1, 1]; 0 is none (measures/lights.py)."""
    whole = maps.maps
    if (
        captured.result.estimate is None
        or whole.size != map_set_of(captured.result.estimate.exemplar).size
    ):
        return {}
    towards = flash_mirror_point(captured.result.material.setup)
    logs = {
        "albedo": whole.diffuse.mean(0).clamp_min(1e-3).log(),
        "F0": whole.specular.mean(0).clamp_min(1e-3).log(),
        "roughness": whole.roughness[0],
        "height": whole.height[0] / whole.texel_size,
    }
    return {f"imprint {name}": imprint(plane, towards) for name, plane in logs.items()}


def map_numbers(captured: CapturedSubject, maps: CapturedMaps) -> Mapping[str, Value]:
    """Contrast and tilt of the maps and of the truth; the capture's run time as `seconds`."""
    evaluator, seconds = captured.evaluator, sum(captured.result.stage_seconds.values())
    numbers = compared_numbers(evaluator.middle(maps.maps), evaluator.truths)
    return {**numbers, "seconds": seconds}
