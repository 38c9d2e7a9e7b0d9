"""`matcap-lab bench floors`: style distances of captures of known materials.

A sample of a material is photographed and captured. The photograph as albedo, the estimated
exemplar and the field synthesised from it are relit and compared with other true samples:
normalised style distance (measures/nsd.py). Also statistics of the maps and of the truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import torch

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.multiview.mosaic import STEEPEST
from matcap.capture.registration.camera import PosedCamera, grid_points
from matcap.capture.result import CaptureResult
from matcap.capture.run import capture_file
from matcap.capture.settings import CaptureSettings
from matcap.example.exemplar import Exemplar
from matcap.field.material import Material
from matcap.flash.geometry import OWN, Extent, FlashSetup, flash_mirror_point
from matcap.flash.light import render_rectified
from matcap.flash.rectify import rectify
from matcap.photo.photo import Photo
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.measures.evaluator import (
    EvaluationSettings,
    Evaluator,
    compared_numbers,
    highlight_contrast,
    imprint,
    map_errors,
    mirrored_scene,
)
from matcap_lab.measures.nsd import SqueezeNetStyle
from matcap_lab.simulate.hand_held import (
    Hand,
    Room,
    hold,
    take_several,
    take_without_flash,
    true_maps_along,
)
from matcap_lab.simulate.named import realise
from matcap_lab.simulate.photograph import Shot, as_photo
from matcap_lab.simulate.specimen import Specimen, photograph

FLOORS = (
    "NSD: normalised style distance by SqueezeNet under new lights; 1 is indistinguishable from "
    "another sample (matcap_lab/measures/nsd.py). Tilt: mean, degrees; albedo: standard deviation "
    "of its logarithm; roughness: mean; each with that of true samples. NSD mirrored: under five "
    "lights whose mirror images are in the picture; highlight: contrast under them, estimated over "
    "true; imprint: of the flash, by map, 0 is none (matcap_lab/measures/evaluator.py)."
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
    style = SqueezeNetStyle()

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
    """Highlight residue of each map, in [-1, 1]; 0 is none (measures/evaluator.py)."""
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


# `matcap-lab bench floors --photographs 1,2,3,5`: accuracy against the number of photographs.

SEVERAL = (
    "NSD: normalised style distance of the exemplar; 1 is indistinguishable from another sample. "
    "Normals: error in degrees where the truth is not flat, `flat` for flat maps; albedo and "
    "roughness: mean absolute differences, of the logarithm and of the value; residual and "
    "predicted: medians over photographs of differences of log radiance, from maps of all "
    "photographs and of all others; beyond: texels that the first photograph does not show."
)


@dataclass(frozen=True)
class Ambient:
    """Variations of the captures: ambient light, union of the views, pose."""

    room: float = 0.0
    """Irradiance of ambient light (hand_held.Room); 0 for darkness. Each count is captured without
    and with one more photograph without flash."""
    union: bool = False
    """Each count of two or more is also captured over the union of the photographs' views."""
    hand: Hand = Hand()
    """Movements of the phone, its flash and lens."""


@dataclass(frozen=True)
class TakenSubject:
    """A sample, its photographs, true poses and true samples (evaluator)."""

    subject: Specimen
    paths: Sequence[Path]
    """Photographs with flash."""
    unlit: Sequence[Path]
    """Photographs without flash."""
    cameras: Sequence[PosedCamera]
    evaluator: Evaluator

    def true_maps(
        self, number: int, estimated: PosedCamera, size: tuple[int, int], extent: Extent = OWN
    ) -> MapSet:
        """See true_maps_along."""
        phone, realise = self.evaluator.settings.camera, self.subject.realise
        return true_maps_along(realise, phone, self.cameras, number, estimated, size, extent)


def several_experiment(
    subjects: Sequence[Specimen],
    counts: Sequence[int],
    out: Path,
    settings: PhotographSettings,
    evaluation: EvaluationSettings,
    ambient: Ambient,
) -> Experiment[TakenSubject, CaptureResult]:
    """Photograph each subject from several poses; capture it from each number of photographs."""
    hand = replace(
        ambient.hand, room=Room(ambient.room, uneven=0.35, hidden=True) if ambient.room else None
    )
    style, phone = SqueezeNetStyle(), evaluation.camera

    def prepare(subject: Specimen) -> TakenSubject:
        realise = subject.realise
        cameras = hold(phone, hand, max(counts), subject.seed)
        shots = take_several(realise, phone, cameras, hand, subject.seed)
        jpeg = settings.jpeg
        paths = [subject.write(shot, out, n, jpeg=jpeg) for n, shot in enumerate(shots)]
        unlit = []
        if ambient.room:
            shot, _ = take_without_flash(realise, phone, cameras, hand, subject.seed + 1)
            unlit = [subject.write(shot, out, len(paths), jpeg=jpeg)]
        evaluator = Evaluator(subject, shots[0].setup, evaluation, {"NSD": style})
        return TakenSubject(subject, paths, unlit, cameras, evaluator)

    def capture(
        count: int, with_unlit: bool, union: bool, taken: TakenSubject, _seed: int
    ) -> CaptureResult:
        others = [*taken.paths[1:count], *(taken.unlit if with_unlit else ())]
        return capture_file(taken.paths[0], replace(settings.captured, union=union), others=others)

    configurations: dict[str, Configuration[TakenSubject, CaptureResult]] = {}
    for count in counts:
        for extra in (False, True) if ambient.room else (False,):
            for union in (False, True) if ambient.union and count > 1 else (False,):
                photographs = f"{count} + 1" if extra else f"{count}"
                name = f"{photographs} photographs{', union' if union else ''}"
                configurations[name] = Configuration(
                    partial(capture, count, extra, union), "several"
                )
    return Experiment(
        "several",
        {subject.name: partial(prepare, subject) for subject in subjects},
        configurations,
        (exemplar_nsd, off, residuals, beyond),
        settings=(settings, evaluation, ambient, max(counts)),
    )


def exemplar_nsd(taken: TakenSubject, result: CaptureResult) -> Mapping[str, Value]:
    """Normalised style distance of the exemplar, tilts, and seconds of the capture."""
    assert result.estimate is not None
    maps, evaluator = map_set_of(result.estimate.first_rectangle), taken.evaluator
    numbers = compared_numbers(evaluator.middle(maps), evaluator.truths)
    return {
        "seconds": sum(result.stage_seconds.values()),
        "NSD": evaluator.style_ratio_of(maps, result.material.setup.intensity),
        "tilt": numbers["tilt"],
        "true tilt": numbers["true tilt"],
    }


def off(taken: TakenSubject, result: CaptureResult) -> Mapping[str, Value]:
    """Errors of maps over the first photograph's rectangle."""
    assert result.estimate is not None
    maps, several = map_set_of(result.estimate.first_rectangle), result.estimate.several
    distortion = (0.0, 0.0) if several is None else several.views[0].camera.lens.distortion
    estimated = PosedCamera.of(result.material.setup, distortion)
    return map_errors(maps, taken.true_maps(0, estimated, maps.size))


def residuals(_taken: TakenSubject, result: CaptureResult) -> Mapping[str, Value]:
    """Number of photographs used, and their residuals against re-renderings."""
    several = None if result.estimate is None else result.estimate.several
    if several is None:
        return {"used": 1.0, "residual": math.nan, "predicted": math.nan}
    return {
        "used": float(len(several.views)),
        "residual": _median(several.residuals),
        "predicted": _median(several.predicted),
    }


def beyond(taken: TakenSubject, result: CaptureResult) -> Mapping[str, Value]:
    """Size of the exemplar, and its errors outside the first photograph's view.

    A texel resampled from one photograph is displaced by that one's registration error, which grows
    with the distance from the first: truth is looked up along its rays.
    """
    piece = result.estimate
    if piece is None or piece.several is None or not piece.several.mosaic.margins.any:
        return {}
    exemplar, views = map_set_of(piece.exemplar), piece.several.views
    mosaic = piece.several.mosaic
    points = grid_points(*exemplar.size, mosaic.extent)
    left = ~mosaic.margins.own(mosaic.size)
    planes, known = torch.zeros(9, *exemplar.size[::-1]), torch.zeros_like(left)
    names = [path.name for path in taken.paths]
    for view in (view for view in views[1:] if view.flash):
        up = view.photo.pixels.shape[0] / view.photo.pixels.shape[1]
        here = left & torch.from_numpy(view.camera.shows(points, up, STEEPEST))
        number = names.index(view.photo.name)
        true = taken.true_maps(number, view.camera, exemplar.size, mosaic.extent)
        planes[:, here] = torch.cat([true.stacked(), true.normal]).float()[:, here]
        known, left = known | here, left & ~here
    whole = replace(MapSet.from_stacked(planes[:6], exemplar.texel_size), painted=planes[6:])
    errors = map_errors(exemplar, whole, known)
    return {"times": mosaic.times, **{f"{name} beyond": value for name, value in errors.items()}}


def _median(values: Sequence[float]) -> float:
    return float(torch.tensor(values).nanmedian()) if values else math.nan


# Baseline methods that make maps of a photograph, and the capture itself.
#
# The baseline is the photograph as albedo; it is given the true camera and flash, which a capture
# has to estimate. Exemplar and field need no decoder: coarse fit, inverse network, refinement,
# index.

_SPECULAR, _ROUGHNESS = 0.04, 0.5


@dataclass(frozen=True)
class CapturedMaps:
    """Maps that a method makes of a photograph."""

    maps: MapSet
    """Maps of the photographed rectangle, or of a square of an endless field."""
    setup: FlashSetup
    """Camera and flash they go with."""


def photo_as_albedo(photo: Photo, setup: FlashSetup, detail: int) -> CapturedMaps:
    """The photograph itself as diffuse albedo; constant F0 and roughness; flat.

    Maps have `detail` texels along the long side. `setup` is the true geometry; its intensity makes
    the re-rendering's mean that of the photograph.
    """
    linear, _ = rectify(photo, setup, detail)
    diffuse = linear.clamp(0.0, 1.0)
    flat = torch.zeros_like(diffuse[:1])
    maps = MapSet(diffuse, flat + _SPECULAR, flat + _ROUGHNESS, flat, texel_size=2.0 / detail)
    again = render_rectified(maps, setup.with_intensity((1.0, 1.0, 1.0))).clamp_min(0.0)
    gain = float(linear.mean() / again.mean())
    return CapturedMaps(maps, setup.with_intensity((gain, gain, gain)))


def exemplar_maps(result: CaptureResult) -> CapturedMaps:
    """The exemplar of a capture by example."""
    assert result.estimate is not None
    return CapturedMaps(map_set_of(result.estimate.exemplar), result.material.setup)


def field_maps(material: Material, width: float, seed: int = 0) -> CapturedMaps:
    """A square of a material's endless field, `width` plane units wide."""
    side = round(width / material.texel_size)
    return CapturedMaps(material.maps(side, side, seed=seed), material.setup)


def true_exemplar(material: str, width: int, height: int, detail: int = 1024) -> Exemplar:
    """The true maps of a simulated material as an exemplar."""
    maps = realise(material, width, height, 11, 2.0 / detail)
    return Exemplar.certain(maps.stacked().float().numpy(), maps.texel_size)
