"""`matcap-lab bench floors --photographs 1,2,3,5`: accuracy against the number of photographs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import map_set_of
from matcap.capture.multiview.mosaic import STEEPEST, sees
from matcap.capture.pipeline import capture_file
from matcap.capture.registration.camera import PosedCamera, grid_points
from matcap.capture.result import CaptureResult
from matcap.flash.extent import OWN, Extent
from matcap_lab.bench.nsd import PhotographSettings
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap_lab.measures.maps import compared_numbers, map_errors
from matcap_lab.simulate.hand_held import (
    Hand,
    Room,
    hold,
    take_several,
    take_without_flash,
    true_maps_along,
)
from matcap_lab.simulate.specimen import Specimen

ABOUT = (
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
    style, phone = evaluation.squeezenet, evaluation.camera

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
        (nsd, off, residuals, beyond),
        settings=(settings, evaluation, ambient, max(counts)),
    )


def nsd(taken: TakenSubject, result: CaptureResult) -> Mapping[str, Value]:
    """Normalised style distance of the exemplar, tilts, and seconds of the capture."""
    assert result.estimate is not None
    maps, evaluator = map_set_of(result.estimate.first_rectangle), taken.evaluator
    middle = evaluator.middle(maps)
    numbers = compared_numbers(middle, evaluator.truths)
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
        here = left & torch.from_numpy(sees(view.camera, points, up, STEEPEST))
        number = names.index(view.photo.name)
        true = taken.true_maps(number, view.camera, exemplar.size, mosaic.extent)
        planes[:, here] = torch.cat([true.stacked(), true.normal]).float()[:, here]
        known, left = known | here, left & ~here
    whole = replace(MapSet.from_stacked(planes[:6], exemplar.texel_size), painted=planes[6:])
    errors = map_errors(exemplar, whole, known)
    return {"times": mosaic.times, **{f"{name} beyond": value for name, value in errors.items()}}


def _median(values: Sequence[float]) -> float:
    return float(torch.tensor(values).nanmedian()) if values else math.nan
