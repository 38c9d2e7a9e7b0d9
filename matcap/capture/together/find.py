"""Estimate the exemplar from several photographs: named stages, from values to values.

The first photograph is read as one alone would be; cameras are found, and photographs brought over
each other; then each is read, and together they decide what one left open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.detail import plane_in_detail, to_be_read
from matcap.capture.piece.absolute import most_probable_scale, scaled
from matcap.capture.piece.classes import Classes
from matcap.capture.piece.find import (
    ExemplarEstimate,
    NetworkPrediction,
    Observation,
    classified,
    confidence,
    evened,
    exemplar_of,
    indexed,
    inpainted,
    levelled,
    measured_relief,
    piece_maps,
    read_piece,
    strengthened,
)
from matcap.capture.piece.finest import finest, sharpness
from matcap.capture.piece.network.network import ExpectedErrors, Inverse
from matcap.capture.piece.strengths import Strengths
from matcap.capture.piece.tuned import INPAINT
from matcap.capture.settings import DETAIL
from matcap.capture.together.align import Aligned, aligned, reframed, shrunk
from matcap.capture.together.hue import achromatic, coloured, on_grid
from matcap.capture.together.place import placed
from matcap.capture.together.predict import Predictions, predictions
from matcap.capture.together.readings import ReadView, read_views, with_others
from matcap.capture.together.room import less_room
from matcap.capture.together.set_report import SetReport
from matcap.capture.together.solve import Solved, solve
from matcap.capture.together.texels import SolveSettings
from matcap.capture.together.union import (
    Reach,
    hue_over,
    reach_of,
    rounded_off,
    scatter,
    seen_by_any,
    spread_over,
    unread,
)
from matcap.capture.together.views import PieceView, SetLight
from matcap.errors import MatcapError
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.flash.coarse import CoarseFit, fit_coarse, under_flash
from matcap.flash.extent import Extent
from matcap.flash.plane import Plane, read_plane
from matcap.flash.registration.camera import PosedCamera
from matcap.flash.registration.register import Registration
from matcap.photo.photo import Photo
from matcap.statistics.lattice import Wave

Stage = Callable[[str], AbstractContextManager[None]]
OnStage = Callable[[str, float], None]


@dataclass(frozen=True)
class MultiViewEstimate:
    """The exemplar estimated from several photographs of one sample.

    Attributes:
        estimate: of the exemplar.
        coarse: fit of the first photograph, its camera estimated from all.
        plane: the first photograph on it.
        waves: of its regular order.
        photo: the first photograph, without what the room added to its light.
    """

    estimate: ExemplarEstimate
    coarse: CoarseFit
    plane: Plane
    waves: tuple[Wave, ...]
    photo: Photo


@dataclass(frozen=True)
class _Single:
    """What the first photograph alone is read as.

    Attributes:
        maps: on the plane's texels.
        errors: (4, H, W) log of what they are expected to be off by.
        strengths: what the photograph says outright.
        metal: (h, w) share that is metal, or None.
    """

    maps: MapSet
    errors: Tensor
    strengths: Strengths | None
    metal: NDArray[np.float32] | None


@torch.no_grad()
def estimate_together(
    photos: Sequence[Photo],
    network: Inverse,
    detail: int | None,
    *,
    union: bool = False,
    stage: Stage,
    on_progress: OnStage,
) -> MultiViewEstimate:
    """The piece of several photographs; an interrupt ends with the best so far.

    Args:
        photos: two or more, the first of which with a flash gives the piece its frame.
        network: reads the first (piece/network/store.py).
        detail: texels across, or None for as many as by default.
        union: the piece is all that photographs show (union.py), not the first one's rectangle.
        stage: entered with the name of each stage.
        on_progress: called with a stage and the share of it that is done.

    Raises:
        MatcapError: no other photograph shows the same piece.
    """
    registration, coarse, plane = _registered(photos, detail, stage)
    first, single = registration.views[0].photo, _read_alone(plane, coarse, network, stage)
    radiometric = all(view.photo.radiometric for view in registration.views)
    reach = reach_of(registration.views, plane.size) if union else Reach.own(plane.size)
    read = spread_over(single.maps, single.errors, reach.margins)
    start = replace(registration, setup=coarse.setup)
    poses, interrupted = _laid_over(start, read, reach.extent, radiometric, stage, on_progress)
    plane, lattice = plane_in_detail(first, poses.setup, detail)
    posed = PosedCamera.of(registration.setup), poses.views[0].camera
    prior, hue = achromatic(reframed(read[0], *posed, reach.extent))
    doubt, readings = unread(read[1], reach), None
    if not interrupted:
        with stage("join"):
            prior, doubt, readings = _all_read(poses, prior, doubt, coarse, network, on_progress)
        interrupted = readings is None
    hue = hue_over(hue, readings, reach)
    if reach.margins.any:
        doubt = torch.minimum(doubt, scatter(single.maps, single.errors)[:, None, None])
    with stage("solve"):
        poses, views, solved = _solved(poses, prior, doubt, hue, radiometric, on_progress)
    interrupted |= solved.interrupted
    coarse = replace(coarse, setup=solved.light.onto(poses.setup))
    with stage("predict"):
        ahead: Predictions | None = None
        if not interrupted and readings is not None:
            ahead = predictions(poses, readings, solved, radiometric, hue)
    with stage("inpaint"):
        reach, whole, solved = _whole(plane, poses, reach, solved)
        exemplar = _inpainted(Observation.of(whole, coarse), solved, hue, views)
    with stage("index"):
        example, scale = _indexed(first, exemplar, single.metal, lattice.waves, reach)
    report = SetReport.of(registration, poses, solved, ahead, reach)
    piece = ExemplarEstimate(
        example, single.strengths, solved.residual[0], 0.0, 1.0, (), interrupted, report, scale
    )
    sharp = sharpness(piece_maps(piece.framed), plane, coarse)
    return MultiViewEstimate(replace(piece, sharpness=sharp), coarse, plane, lattice.waves, first)


def _whole(
    plane: Plane, poses: Aligned, reach: Reach, solved: Solved
) -> tuple[Reach, Plane, Solved]:
    """The first photograph on the mosaic's grid, unseen texels masked, and maps there."""
    if not reach.margins.any:
        return reach, plane, solved
    known = seen_by_any(poses.views, reach)
    slow = SolveSettings().slow * plane.size[0]
    return (
        replace(reach, known=float(known.float().mean())),
        plane.over(reach.margins, known),
        replace(solved, maps=rounded_off(solved.maps, known, slow)),
    )


def _indexed(
    photo: Photo,
    exemplar: Exemplar,
    metal: NDArray[np.float32] | None,
    waves: tuple[Wave, ...],
    reach: Reach,
) -> tuple[Example, float]:
    """The exemplar to be rearranged, and what its albedo and F0 were scaled by."""
    known = photo.flash_intensity is not None
    own = exemplar.cut(*reach.margins.inside(reach.size)) if reach.margins.any else exemplar
    scale = 1.0 if known else most_probable_scale(own, metal)
    return indexed(scaled(exemplar, scale), waves), scale


def _registered(
    photos: Sequence[Photo], detail: int | None, stage: Stage
) -> tuple[Registration, CoarseFit, Plane]:
    """Cameras by what photographs have in common; with them the coarse fit, and the plane."""
    with stage("register"):
        registration = placed(photos)
        if len(registration.views) < 2:
            raise _none_fits(registration)
        registration, _ = less_room(registration)
    with stage("coarse fit"):
        first, setup = registration.views[0].photo, registration.setup
        coarse = fit_coarse(replace(first, fov=setup.fov), tilt=setup.tilt)
        coarse = under_flash(coarse, first.flash_intensity)
        # What the fit hardly moved at all is the camera still.
        camera = replace(coarse.setup, fov=setup.fov, tilt=setup.tilt)
        plane = read_plane(first, camera, detail or DETAIL)
    return registration, replace(coarse, setup=camera), plane


def _solved(
    poses: Aligned,
    prior: MapSet,
    doubt: Tensor,
    hue: Tensor | None,
    radiometric: bool,
    on_progress: OnStage,
) -> tuple[Aligned, list[PieceView], Solved]:
    """All photographs on the piece's grid, and what they make of it: coarse, then fine.

    Photographs were brought over each other by relief as it was read, which is too flat; by the
    coarse grid's they are looked up with their whole parallax.
    """
    begun: Solved | None = None
    light, rounds = poses.light, SolveSettings().rounds
    across, down = prior.size
    if poses.extent.unit(across) >= 2 * SolveSettings().coarse:
        half = (round(down / 2), round(across / 2))
        small, unsure = shrunk(prior, doubt, half, poses.extent)
        views = _on_grid(poses, half[1], half[0], hue)
        begun = solve(
            views,
            small,
            unsure,
            light,
            radiometric=radiometric,
            on_progress=lambda share: on_progress("solve", 0.4 * share),
        )
        light, rounds = begun.light, SolveSettings().finer
        relief = np.asarray(begun.maps.height[0].numpy(), np.float32)
        places = tuple(replace(place, relief=relief) for place in poses.places)
        poses = replace(poses, places=places)
    views = _on_grid(poses, across, down, hue)
    solved = solve(
        views,
        prior,
        doubt,
        light,
        radiometric=radiometric,
        settings=replace(SolveSettings(), rounds=rounds),
        on_progress=lambda share: on_progress(
            "solve", share if begun is None else 0.4 + 0.6 * share
        ),
        begun=begun,
    )
    return poses, views, solved


def _on_grid(poses: Aligned, across: int, down: int, hue: Tensor | None) -> list[PieceView]:
    both = zip(poses.views, poses.places, strict=True)
    return [PieceView.of(view, across, down, place, hue) for view, place in both]


def _none_fits(registration: Registration) -> MatcapError:
    each = "; ".join(f"{one.name}: {one.why}" for one in registration.left_out)
    return MatcapError(
        f"no other photograph can be laid over {registration.views[0].photo.name} ({each})",
        remedy="photograph the same piece from the same distance, moved by a third of it each time",
    )


def _read_alone(plane: Plane, coarse: CoarseFit, network: Inverse, stage: Stage) -> _Single:
    """The first photograph read alone, on the plane's texels."""
    with stage("piece"):
        read, _ = to_be_read(plane)
        observed = Observation.of(read, coarse)
        observed, prediction = read_piece(observed, network)
    with stage("strengths"):
        strengths = measured_relief(observed, prediction)
        observed, prediction = classified(observed, strengthened(observed, prediction, strengths))
    with stage("refine"), torch.no_grad():
        prediction = levelled(observed, prediction)
        exemplar = exemplar_of(observed, prediction)
        if plane.size != read.size:
            exemplar = finest(exemplar, plane, coarse)
    errors = prediction.errors.stacked()
    wide = F.interpolate(errors[None], size=plane.size[::-1], mode="bilinear")[0]
    return _Single(piece_maps(exemplar), wide, strengths, prediction.metal)


def _laid_over(
    registration: Registration,
    read: tuple[MapSet, Tensor],
    extent: Extent,
    radiometric: bool,
    stage: Stage,
    tell: OnStage,
) -> tuple[Aligned, bool]:
    """Photographs brought over each other, and whether that was interrupted: as they were then."""
    views = registration.views
    light = SetLight.of(registration.setup, len(views), views[0].photo.profile)
    try:
        with stage("align"):
            return aligned(
                registration,
                *read,
                light,
                radiometric=radiometric,
                extent=extent,
                on_progress=partial(tell, "align"),
            ), False
    except KeyboardInterrupt:
        return Aligned.of(registration, registration.setup, light, extent), True


def _all_read(
    poses: Aligned,
    prior: MapSet,
    doubt: Tensor,
    coarse: CoarseFit,
    network: Inverse,
    on_progress: OnStage,
) -> tuple[MapSet, Tensor, list[ReadView | None] | None]:
    """Prior and doubts by all photographs and what each was read as; interrupted the first's."""
    read = partial(_read_plainly, network)
    try:
        readings = read_views(poses, prior, doubt, coarse, read, partial(on_progress, "join"))
    except KeyboardInterrupt:
        return prior, doubt, None
    return *with_others(prior, doubt, readings), readings


def _read_plainly(network: Inverse, plane: Plane, coarse: CoarseFit) -> tuple[MapSet, Tensor]:
    """Maps of a photograph read alone on its own plane, and the log of their errors."""
    single = _read_alone(plane, coarse, network, lambda _name: nullcontext())
    return single.maps, single.errors


def _inpainted(
    observed: Observation, solved: Solved, hue: Tensor | None, views: Sequence[PieceView]
) -> Exemplar:
    """The solved maps with the specular tint of metal, inpainted under the highlight."""
    if hue is not None:
        observed = replace(
            observed, light=replace(observed.light, hue=on_grid(hue, solved.maps.size))
        )
    maps = coloured(solved.maps, hue)
    seen = torch.stack([view.seen.float().mean(0) for view in views]).amax(0)
    errors = ExpectedErrors.from_stacked(solved.errors)
    unit = None
    if observed.plane.margins.any and observed.plane.left_out is not None:
        seen = seen * ~observed.plane.left_out  # unseen, or from too oblique a view
        unit = observed.plane.extent.unit(observed.plane.size[0])
    trusted = confidence(errors, np.asarray(seen.numpy(), np.float32), unit)
    classes = Classes.whole(observed.specular_fraction.shape, metal=False)
    prediction = NetworkPrediction(observed.light.departures(maps), errors, trusted, None, classes)
    prediction = replace(prediction, departures=evened(observed, prediction, prediction.departures))
    return inpainted(observed, prediction, INPAINT.tried_at_once)
