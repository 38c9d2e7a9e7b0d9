"""The stages that estimate the exemplar of several photographs, in order.

In come photographs, out go the first one, rectified, and an ExemplarEstimate in its frame.
Registration by features; coarse fit and network prediction of the first photograph; registration by
rendering; joint estimation of all maps; inpainting and indexing. Beyond the first photograph, a
mosaic (mosaic.py) also needs predictions of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.detail import Rectified, network_input
from matcap.capture.piece.absolute import most_probable_scale, scaled
from matcap.capture.piece.classes import Classes
from matcap.capture.piece.detail_transfer import transfer_detail
from matcap.capture.piece.find import ExemplarEstimate, indexed, map_set_of, refined
from matcap.capture.piece.inpaint import inpainted
from matcap.capture.piece.network.network import ExpectedErrors, Inverse
from matcap.capture.piece.observation import Observation
from matcap.capture.piece.predict import NetworkPrediction, confidence_of, exemplar_of
from matcap.capture.piece.refine import fitted_to_highlight
from matcap.capture.piece.strengths import Strengths
from matcap.capture.progress import CaptureClock
from matcap.capture.registration.camera import PosedCamera
from matcap.capture.registration.register import Registration, register_in_any_order
from matcap.capture.together.align import Aligned, aligned, reframed
from matcap.capture.together.ambient_light import SLOW, without_ambient
from matcap.capture.together.leave_one_out import leave_one_out
from matcap.capture.together.mosaic import (
    Mosaic,
    extrapolated,
    mosaic_of,
    scatter,
    seen_by_any,
    spread_over,
    tint_over,
    unpredicted,
)
from matcap.capture.together.pair import on_albedo
from matcap.capture.together.set_report import SetReport
from matcap.capture.together.solve import ROUNDS, Solved, solve
from matcap.capture.together.texels import Estimate
from matcap.capture.together.tint import achromatic, coloured, on_grid
from matcap.capture.together.view_predictions import predict_views, with_others
from matcap.capture.together.views import ResampledView
from matcap.errors import MatcapError
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.field.single import one_thread
from matcap.flash.coarse.fit import CoarseFit, fit_coarse, under_flash
from matcap.flash.plane import Plane, read_plane
from matcap.photo.photo import Photo
from matcap.statistics.lattice import Wave

# Steps per texel in each round, on a grid that starts from the solution of one half as fine.
_FINER: tuple[int, ...] = (1,)
_COARSE = 320  # texels across the grid that starts from the network's prediction


@torch.no_grad()
def estimate_together(
    photos: Sequence[Photo],
    network: Inverse,
    detail: int,
    clock: CaptureClock,
    *,
    union: bool = False,
) -> tuple[Rectified, ExemplarEstimate]:
    """Estimate the exemplar of several photographs; an interrupt ends with the best result so far.

    Also returns the first photograph, less ambient light, rectified by its registered camera.

    Args:
        photos: two or more; the first one with flash defines the frame.
        network: the inverse network (piece/network/network.py).
        detail: texels along the long side.
        clock: of the stages.
        union: estimate all that the photographs show (mosaic.py), not the first one's rectangle.

    Raises:
        MatcapError: no other photograph can be registered to the first.
    """
    registration, coarse, plane = registered(photos, detail, clock)
    single, strengths, metal = predict_alone(plane, coarse, network, clock)
    mosaic = mosaic_of(registration.views, plane.size) if union else Mosaic.own(plane.size)
    prediction = spread_over(single, mosaic.margins)
    begun = Aligned.of(registration.views, coarse.setup, mosaic.extent)
    poses, interrupted = _aligned(begun, single.maps, prediction, clock)
    first = poses.views[0].photo
    rectified = Rectified.of(first, replace(coarse, setup=poses.setup), detail)
    posed = PosedCamera.of(registration.setup), poses.views[0].camera
    maps, tint = achromatic(reframed(prediction.maps, *posed, mosaic.extent))
    prediction = Estimate(maps, unpredicted(prediction.log_error, mosaic))
    if mosaic.margins.any:
        if not interrupted:
            every = _fused(poses, prediction, tint, mosaic, coarse, network)
            prediction, tint, interrupted = every
        most = scatter(single)[:, None, None]
        prediction = replace(prediction, log_error=torch.minimum(prediction.log_error, most))
    with clock.stage("solve"):
        poses, views, solved = _solved(poses, prediction, tint, clock)
    interrupted |= solved.interrupted
    rectified = replace(rectified, coarse=replace(coarse, setup=solved.light.onto(poses.setup)))
    with clock.stage("predict"):
        unknown = (), solved.residual
        ahead, residuals = (
            unknown if interrupted else leave_one_out(poses, prediction, solved, tint)
        )
    with clock.stage("inpaint"):
        mosaic, whole, solved = _whole(rectified.whole, poses, mosaic, solved)
        exemplar = _inpainted(Observation.of(whole, rectified.coarse), solved, tint, views)
    with clock.stage("index"):
        exemplar, example, scale = _indexed(first, exemplar, metal, rectified.waves, mosaic)
    offset, reported = rectified.coarse.setup.offset, mosaic if mosaic.margins.any else None
    left_out, error = registration.left_out, solved.residual[0]
    report = SetReport(poses.views, residuals, ahead, left_out, solved.measured, offset, reported)
    estimate = ExemplarEstimate(
        exemplar, example, strengths, error, 0.0, 1.0, interrupted, report, scale, first.turned
    )
    return rectified, estimate.with_sharpness(rectified)


def registered(
    photos: Sequence[Photo], detail: int, clock: CaptureClock
) -> tuple[Registration, CoarseFit, Plane]:
    """Register photographs by features; fit and rectify the first with its registered camera.

    Raises:
        MatcapError: no other photograph can be registered to the first.
    """
    with clock.stage("register"):
        registration = register_in_any_order(photos)
        if len(registration.views) < 2:
            each = "; ".join(f"{one.name}: {one.why}" for one in registration.left_out)
            name = registration.views[0].photo.name
            raise MatcapError(
                f"no other photograph can be registered to {name} ({each})",
                remedy="photograph the same sample again, sharp, with an overlap of two thirds",
            )
    with clock.stage("coarse fit"):
        first, setup = without_ambient(registration.views)[0].photo, registration.setup
        with one_thread():
            coarse = fit_coarse(replace(first, fov=setup.fov), tilt=setup.tilt)
        coarse = under_flash(coarse, first.flash_intensity)
        views = tuple(
            replace(view, photo=view.photo.linearised(coarse.tone)) for view in registration.views
        )
        # The registered camera replaces the coarse fit's.
        camera = replace(coarse.setup, fov=setup.fov, tilt=setup.tilt)
        plane = read_plane(without_ambient(views)[0].photo, camera, detail)
        registration = replace(registration, views=views)
    return registration, replace(coarse, setup=camera), plane


@torch.no_grad()
def predict_alone(
    plane: Plane, coarse: CoarseFit, network: Inverse, clock: CaptureClock
) -> tuple[Estimate, Strengths | None, NDArray[np.float32]]:
    """Estimate from one photograph alone, on its plane's texels.

    Returns:
        Maps and their errors; relief and albedo energies measured in the photograph, or None; and
        (h, w) share of metal in each texel.
    """
    observed, prediction, strengths = refined(network_input(plane), coarse, network, clock)
    exemplar = transfer_detail(exemplar_of(observed, prediction), plane, coarse)
    errors = prediction.errors.stacked()
    wide = F.interpolate(errors[None], size=plane.size[::-1], mode="bilinear")[0]
    return Estimate(map_set_of(exemplar), wide), strengths, prediction.metal


def _aligned(
    begun: Aligned, own: MapSet, prediction: Estimate, clock: CaptureClock
) -> tuple[Aligned, bool]:
    """Register photographs by rendering; (`begun` or its refinement, whether interrupted).

    Args:
        begun: registration by features.
        own: predicted maps of the first photograph's rectangle.
        prediction: the network's, over the exemplar's extent.
        clock: of the stages.
    """
    try:
        with clock.stage("align"):
            views = without_ambient(on_albedo(begun.views, begun.setup, own))
            begun, on_progress = replace(begun, views=views), clock.callback("align")
            return aligned(begun, prediction, on_progress=on_progress), False
    except KeyboardInterrupt:
        return begun, True


def _fused(
    poses: Aligned,
    first: Estimate,
    tint: Tensor | None,
    mosaic: Mosaic,
    coarse: CoarseFit,
    network: Inverse,
) -> tuple[Estimate, Tensor | None, bool]:
    """Prediction and tint of a mosaic from all photographs, or `first` and `tint` if interrupted.

    Also returns whether it was interrupted.
    """

    def predict(plane: Plane, fit: CoarseFit) -> Estimate:
        return predict_alone(plane, fit, network, CaptureClock(None))[0]

    try:
        every = predict_views(poses, first, coarse, predict)
    except KeyboardInterrupt:
        return first, tint, True
    return with_others(first, every), tint_over(tint, every, mosaic), False


def _solved(
    poses: Aligned,
    prediction: Estimate,
    tint: Tensor | None,
    clock: CaptureClock,
) -> tuple[Aligned, list[ResampledView], Solved]:
    """Joint estimation on a grid of half the texels across, then on all.

    Photographs were registered with the parallax of predicted relief, which is too flat; on the
    fine grid they are resampled with that of the relief estimated on the coarse one.
    """
    begun: Solved | None = None
    light, done, rounds = poses.light, 0.0, ROUNDS
    across, down = prediction.maps.size
    if poses.extent.unit(across) >= 2 * _COARSE:
        done = 0.4
        half = (round(down / 2), round(across / 2))
        views = poses.on_grid(half[1], half[0], tint)
        small = prediction.resized(half, poses.extent)
        begun = solve(views, small, light, on_progress=clock.callback("solve", 0.0, done))
        light, rounds = begun.light, _FINER
        relief = np.asarray(begun.maps.height[0].numpy(), np.float32)
        poses = replace(poses, warps=tuple(replace(w, relief=relief) for w in poses.warps))
    views = poses.on_grid(across, down, tint)
    on_progress = clock.callback("solve", done, 1.0)
    return poses, views, solve(views, prediction, light, begun, on_progress, rounds=rounds)


def _whole(
    plane: Plane, poses: Aligned, mosaic: Mosaic, solved: Solved
) -> tuple[Mosaic, Plane, Solved]:
    """The first photograph on the mosaic's grid, unseen texels masked, and maps there."""
    if not mosaic.margins.any:
        return mosaic, plane, solved
    known = seen_by_any(poses.views, mosaic)
    maps = extrapolated(solved.maps, known, SLOW * plane.size[0])
    return (
        replace(mosaic, known=float(known.float().mean())),
        plane.over(mosaic.margins, known),
        replace(solved, estimate=replace(solved.estimate, maps=maps)),
    )


def _inpainted(
    observed: Observation, solved: Solved, tint: Tensor | None, views: Sequence[ResampledView]
) -> Exemplar:
    """The solved maps with the specular tint of metal, inpainted under the highlight.

    Relief and mean parameters are fitted to the first photograph's highlight, as those of a single
    photograph are: robust weights take a mirrored light that is a little displaced for an outlier.
    """
    if tint is not None:
        observed = replace(
            observed, light=replace(observed.light, tint=on_grid(tint, solved.maps.size))
        )
    maps = coloured(solved.maps, tint)
    seen = torch.stack([view.seen.float().mean(0) for view in views]).amax(0)
    seen = seen * observed.plane.kept  # of a mosaic, not where unseen, or seen too obliquely
    errors = ExpectedErrors.from_stacked(solved.estimate.log_error)
    confidence = confidence_of(errors, np.asarray(seen.numpy(), np.float32), observed.plane.unit)
    classes = Classes.whole(observed.specular_fraction.shape, metal=False)
    prediction = NetworkPrediction(
        observed.light.residuals(maps), errors, confidence, None, classes
    )
    return inpainted(exemplar_of(observed, fitted_to_highlight(observed, prediction)), observed)


def _indexed(
    photo: Photo,
    exemplar: Exemplar,
    metal: NDArray[np.float32],
    waves: tuple[Wave, ...],
    mosaic: Mosaic,
) -> tuple[Exemplar, Example, float]:
    """The exemplar, its index, and the factor on its albedo and F0 (absolute.py)."""
    known = photo.flash_intensity is not None
    own = exemplar.cut(*mosaic.margins.inside(mosaic.size))
    scale = 1.0 if known else most_probable_scale(own, metal)
    return *indexed(scaled(exemplar, scale).rounded(), waves, turned=photo.turned), scale
