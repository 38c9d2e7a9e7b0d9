"""`matcap-lab bench floors` and `quality`: style distances of captures of known materials.

A sample of a material is photographed and captured. The photograph as albedo, the estimated
exemplar and the field synthesised from it are relit and compared with other true samples:
normalised style distance (measures/nsd.py). Also statistics of the maps and of the truth. `quality`
compares decoders too, by Portilla-Simoncelli statistics and random filters (measures/style.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from matcap.capture.exemplar.estimate import map_set_of
from matcap.capture.pipeline import capture_file
from matcap.capture.result import CaptureResult
from matcap.capture.settings import CaptureSettings
from matcap.files.picture import write_picture
from matcap.files.srgb import srgb_decode_tensor
from matcap.flash.geometry import flash_mirror_point
from matcap.photo.photo import Photo
from matcap_lab.bench.methods import CapturedMaps, exemplar_maps, field_maps, photo_as_albedo
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment, choose
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap_lab.measures.lights import highlight_contrast, imprint, mirrored_scene
from matcap_lab.measures.maps import compared_numbers
from matcap_lab.measures.style import PortillaSimoncelli, RandomFilters, Style
from matcap_lab.simulate.photograph import Shot, as_photo
from matcap_lab.simulate.specimen import EXAMPLES, Specimen, photograph

ABOUT = (
    "NSD: normalised style distance by SqueezeNet under new lights; 1 is indistinguishable from "
    "another sample (matcap_lab/measures/nsd.py). Tilt: mean, degrees; albedo: standard deviation "
    "of its logarithm; roughness: mean; each with that of true samples. NSD mirrored: under five "
    "lights whose mirror images are in the picture; highlight: contrast under them, estimated over "
    "true; imprint: of the flash, by map, 0 is none (matcap_lab/measures/lights.py)."
)
QUALITY = (
    "Normalised style distance of relit maps to other true samples, over ten point lights away "
    "from the flash; 1 is indistinguishable. PS: Portilla-Simoncelli statistics; RF: random "
    "filters unknown to capture (matcap_lab/measures/style.py); mean: of both."
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


@dataclass(frozen=True)
class PicturedSubject:
    """A photograph, and its pictures."""

    path: Path
    """Its DNG, the only input of captures."""
    photo: Photo
    """The photograph in memory."""
    evaluator: Evaluator
    columns: dict[str, Tensor]
    """Pictures by method, truth first, for the sheet."""


def quality_experiment(
    capture: Callable[[Path], CapturedMaps],
    out: Path,
    *,
    materials: Sequence[str] = (),
    methods: Sequence[str] = (),
    settings: EvaluationSettings,
    captured: object = None,
) -> Experiment[PicturedSubject, Tensor]:
    """Methods, all by default, on materials of EXAMPLES; photographs and sheets go to `out`.

    `capture`, from a DNG's path, is the method `decoder`; rows of other settings of it, `captured`,
    are measured again. Of `settings` lights and true samples are set here.

    Raises:
        UsageError: no such material or method.
    """
    evaluation = replace(settings, finer=2, every=1, first=1001)

    def by_example(seen: PicturedSubject) -> CaptureResult:
        return capture_file(seen.path, CaptureSettings(detail=evaluation.detail))

    def albedo(seen: PicturedSubject) -> CapturedMaps:
        return photo_as_albedo(seen.photo, seen.evaluator.flash, evaluation.detail)

    known: Mapping[str, Callable[[PicturedSubject], CapturedMaps]] = {
        "decoder": lambda seen: capture(seen.path),
        "exemplar": lambda seen: exemplar_maps(by_example(seen)),
        "by-example": lambda seen: field_maps(by_example(seen).material, evaluation.width),
        "photo-as-albedo": albedo,
    }
    chosen = choose(known, methods)
    portilla = PortillaSimoncelli((evaluation.size,) * 2)
    styles: dict[str, Style] = {"PS": portilla, "RF": RandomFilters()}

    def prepare(specimen: Specimen) -> PicturedSubject:
        path, shot = photograph(specimen, evaluation.camera, out)
        evaluator = Evaluator(specimen, shot.setup, evaluation, styles)
        photo = as_photo(shot, specimen.seed, path.name)
        return PicturedSubject(path, photo, evaluator, {"truth": evaluator.pictures[0]})

    def run(method: str, seen: PicturedSubject, _seed: int) -> Tensor:
        made, evaluator = chosen[method](seen), seen.evaluator
        pictures = evaluator.relit(evaluator.middle(made.maps), made.setup.intensity)
        seen.columns[method] = pictures
        return pictures

    return Experiment(
        "quality",
        {name: partial(prepare, one) for name, one in choose(EXAMPLES, materials).items()},
        {method: Configuration(partial(run, method)) for method in chosen},
        (style_ratios, sheet),
        settings=(evaluation, captured),
    )


def style_ratios(seen: PicturedSubject, pictures: Tensor) -> Mapping[str, Value]:
    """Style ratio by each style, and their mean."""
    ratio = seen.evaluator.style_ratio
    distances = {name: ratio(pictures, name) for name in seen.evaluator.styles}
    return {**distances, "mean": sum(distances.values()) / len(distances)}


def sheet(seen: PicturedSubject, _pictures: Tensor) -> Mapping[str, Value]:
    """Write a sheet, no column: a row for every third light; truth first, then each method."""
    rows = [torch.cat(list(row), dim=2) for row in zip(*seen.columns.values(), strict=True)]
    linear = srgb_decode_tensor(torch.cat(rows[::3], dim=1))
    write_picture(linear.permute(1, 2, 0).contiguous().numpy(), seen.path.with_suffix(".png"))
    return {}


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
