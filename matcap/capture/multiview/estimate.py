"""The stages that estimate the exemplar of several photographs, in order.

In come photographs, out go the first one, rectified, and an ExemplarEstimate in its frame.
Registration by features; coarse fit and network prediction of the first photograph; registration by
rendering; joint estimation of all maps; inpainting and indexing. Beyond the first photograph, a
mosaic (mosaic.py) also needs predictions of the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.detail_transfer import transfer_detail
from matcap.capture.exemplar.estimate import (
    ExemplarEstimate,
    KnownMeans,
    estimate_exemplar,
    indexed,
    refined,
)
from matcap.capture.exemplar.inpaint import inpainted
from matcap.capture.exemplar.mean_parameters import most_probable_scale, scaled
from matcap.capture.exemplar.network.network import ExpectedErrors, Inverse
from matcap.capture.exemplar.predict import (
    Classes,
    NetworkPrediction,
    confidence_of,
    exemplar_of,
    map_set_of,
)
from matcap.capture.exemplar.refine import flattened, with_mean_parameters
from matcap.capture.exemplar.relief_spectrum import ReliefSpectrum
from matcap.capture.multiview.align import Aligned, aligned, reframed
from matcap.capture.multiview.basis import with_basis
from matcap.capture.multiview.mosaic import (
    Mosaic,
    extrapolated,
    mosaic_of,
    predicted_beyond,
    seen_by_any,
    spread_over,
)
from matcap.capture.multiview.pair import on_albedo
from matcap.capture.multiview.set_report import LeaveOneOut, SetReport, leave_one_out
from matcap.capture.multiview.solve import ROUNDS, Solved, solve
from matcap.capture.multiview.texels import Estimate
from matcap.capture.multiview.views import SLOW, Resampled, ResampledView, without_ambient
from matcap.capture.rectified import Observation, Rectified, network_input
from matcap.capture.registration.camera import PosedCamera
from matcap.capture.registration.register import Registration
from matcap.capture.settings import CaptureClock, RunStatus
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.files.threads import one_thread
from matcap.flash.coarse.fit import CoarseFit, fit_coarse, rescale_to_flash
from matcap.flash.rectify import Plane, read_plane
from matcap.photo.photo import Photo
from matcap.statistics.lattice import Wave

Result = TypeVar("Result")
Floats = NDArray[np.float32]

# Steps per texel in each round, on a grid that starts from the solution of one half as fine.
_FINER: tuple[int, ...] = (1,)
_COARSE = 320  # texels across the grid that starts from the network's prediction
_COARSE_SHARE = 0.4  # of the time


@torch.no_grad()
def estimate_multiview(
    registration: Registration, network: Inverse, detail: int, clock: CaptureClock, *, union: bool
) -> tuple[Rectified, ExemplarEstimate]:
    """Estimate the exemplar of several photographs; an interrupt ends with the best result so far.

    Also returns the first photograph, less ambient light, rectified by its registered camera.

    Args:
        registration: two photographs or more; the first one defines the frame.
        network, detail, clock: the inverse network, texels along the long side, of the stages.
        union: estimate all that the photographs show (mosaic.py), not the first one's rectangle.
    """
    registration, coarse, plane = fitted_first(registration, detail, clock)
    single, spectrum, metal = predict_alone(plane, coarse, network, clock)
    mosaic = mosaic_of(registration.views, plane.size) if union else Mosaic.own(plane.size)
    by_features = Aligned.of(registration.views, coarse.setup, mosaic.extent)
    spread = spread_over(single, mosaic.margins)
    with clock.stage("align"):
        rendered = partial(_aligned, by_features, single.maps, spread, clock)
        alignment = _unless_interrupted(clock, by_features, rendered)
    cameras = PosedCamera.of(by_features.setup), alignment.views[0].camera
    alone = replace(spread, maps=reframed(spread.maps, *cameras, mosaic.extent))
    if mosaic.margins.any and clock.status is RunStatus.DONE:
        several = partial(predicted_beyond, alignment, alone, mosaic, coarse)
        own = partial(predict_alone, network=network, clock=CaptureClock(None))
        beyond = partial(several, lambda plane, fit: own(plane, fit)[0])
        alone = _unless_interrupted(clock, alone, beyond)
    begun = alignment, alone
    with clock.stage("solve"):
        if clock.status is RunStatus.DONE:
            begun = _unless_interrupted(clock, begun, partial(with_basis, *begun))
        alignment, resampled, solved = _solved(*begun, clock)
    camera_only = replace(coarse, setup=alignment.setup)
    with clock.stage("predict"):
        check = partial(leave_one_out, alignment, solved, begun[1], alone, by_features.light)
        checked = check() if clock.status is RunStatus.DONE else LeaveOneOut((), ())
    first = alignment.views[0].photo
    report = SetReport.of(alignment, registration, solved, checked, mosaic)
    rectified = Rectified.of(first, camera_only, detail)
    if report.kept_first is not None:
        of_one = CaptureClock(None), KnownMeans(absolute=first.flash_intensity is not None)
        with clock.stage("inpaint"):  # its own stages are over
            result = estimate_exemplar(rectified, network, *of_one, turned=first.turned)
        return rectified, replace(result, several=report)
    lit = replace(coarse, setup=solved.light.onto(alignment.setup))
    with clock.stage("inpaint"):
        mosaic, plane, maps = _whole(rectified.whole, alignment, mosaic, solved.maps)
        estimate = replace(solved.estimate, maps=maps)
        exemplar = _inpainted(Observation.of(plane, lit), estimate, resampled)
    with clock.stage("index"):
        metal = metal if estimate.basis is None else estimate.basis.metallic_share
        exemplar, example, scale = _indexed(first, exemplar, metal, rectified.waves, mosaic)
    result = ExemplarEstimate(exemplar, example, spectrum, solved.residual[0], report, scale)
    return replace(rectified, coarse=lit), replace(result, turned=first.turned)


def _unless_interrupted(
    clock: CaptureClock, otherwise: Result, compute: Callable[[], Result]
) -> Result:
    """What is computed; after Ctrl-C, which the clock's status then says, `otherwise`."""
    try:
        return compute()
    except KeyboardInterrupt:
        clock.status = RunStatus.INTERRUPTED
        return otherwise


def fitted_first(
    registration: Registration, detail: int, clock: CaptureClock
) -> tuple[Registration, CoarseFit, Plane]:
    """Fit and rectify the first photograph with its registered camera; tone curves undone."""
    with clock.stage("coarse fit"):
        first, setup = without_ambient(registration.views)[0].photo, registration.setup
        with one_thread():
            coarse = fit_coarse(replace(first, fov=setup.fov), tilt=setup.tilt)
        coarse = rescale_to_flash(coarse, first.flash_intensity)
        linear = (view.photo.linearised(coarse.tone) for view in registration.views)
        of_views = zip(registration.views, linear, strict=True)
        views = tuple(replace(view, photo=photo) for view, photo in of_views)
        # The registered camera replaces the coarse fit's.
        camera = replace(coarse.setup, fov=setup.fov, tilt=setup.tilt)
        plane = read_plane(without_ambient(views)[0].photo, camera, detail)
    return replace(registration, views=views), replace(coarse, setup=camera), plane


@torch.no_grad()
def predict_alone(
    plane: Plane, coarse: CoarseFit, network: Inverse, clock: CaptureClock
) -> tuple[Estimate, ReliefSpectrum | None, Floats]:
    """Estimate from one photograph alone, on its plane's texels.

    Returns:
        Maps and their errors; relief and albedo energies measured in the photograph, or None; and
        (h, w) share of metal in each texel.
    """
    observed, prediction, spectrum = refined(network_input(plane), coarse, network, clock)
    exemplar = transfer_detail(exemplar_of(observed, prediction), plane, coarse)
    errors = prediction.errors.stacked()
    wide = F.interpolate(errors[None], size=plane.size[::-1], mode="bilinear")[0]
    return Estimate(map_set_of(exemplar), wide), spectrum, prediction.metal


def _aligned(
    by_features: Aligned, own: MapSet, prediction: Estimate, clock: CaptureClock
) -> Aligned:
    """Register photographs by rendering, after the one without flash is subtracted.

    `own` are predicted maps of the first photograph's rectangle, `prediction` covers the extent.
    """
    cameras = PosedCamera.of(by_features.setup), by_features.views[0].camera
    views = without_ambient(on_albedo(by_features.views, reframed(own, *cameras)))
    return aligned(replace(by_features, views=views), prediction, clock.callback("align"))


def _solved(
    alignment: Aligned, prior: Estimate, clock: CaptureClock
) -> tuple[Aligned, list[ResampledView], Solved]:
    """Joint estimation on a grid of half the texels across, then on all.

    Photographs were registered with the parallax of predicted relief, which is too flat; on the
    fine grid they are resampled with that of the relief estimated on the coarse one.
    """
    (across, down), coarser, share = prior.maps.size, None, 0.0
    if alignment.extent.unit(across) >= 2 * _COARSE:
        share, size = _COARSE_SHARE, (round(across / 2), round(down / 2))
        small = prior.resized(size[::-1], alignment.extent)
        progress = clock.callback("solve", 0.0, share)
        coarser = solve(alignment.on_grid(*size), small, alignment.light, on_progress=progress)
        alignment = replace(alignment, relief=coarser.maps.height[0].numpy(), light=coarser.light)
    views, rounds = alignment.on_grid(across, down), ROUNDS if coarser is None else _FINER
    progress = clock.callback("solve", share, 1.0)
    solved = solve(views, prior, alignment.light, coarser, progress, rounds=rounds)
    if solved.interrupted:
        clock.status = RunStatus.INTERRUPTED
    return alignment, views, solved


def _whole(
    plane: Plane, alignment: Aligned, mosaic: Mosaic, maps: MapSet
) -> tuple[Mosaic, Plane, MapSet]:
    """The first photograph on the mosaic's grid, unseen texels masked, and maps there."""
    if not mosaic.margins.any:
        return mosaic, plane, maps
    known = seen_by_any(alignment.views, mosaic)
    return (
        replace(mosaic, known=float(known.float().mean())),
        plane.over(mosaic.margins, known),
        extrapolated(maps, known, SLOW * plane.size[0]),
    )


def _inpainted(observed: Observation, estimate: Estimate, views: Resampled) -> Exemplar:
    """The solved maps, inpainted under the highlight.

    Of one material, mean parameters are fitted to the first photograph's highlight, as those of a
    single photograph are: robust weights take a mirrored light that is a little displaced for an
    outlier. Relief, which all measure, is kept. Of several materials nothing is copied: what one
    photograph's highlight hides, others show.
    """
    maps = estimate.maps
    tint = maps.specular / maps.specular.mean(0, keepdim=True).clamp_min(1e-4)
    light = replace(observed.light, tint=tint)
    observed = replace(observed, light=light)
    seen = torch.stack([view.seen.float().mean(0) for view in views]).amax(0)
    seen = seen * observed.plane.kept  # of a mosaic, not where unseen, or seen too obliquely
    errors = ExpectedErrors.from_stacked(estimate.log_error)
    confidence = confidence_of(errors, np.asarray(seen.numpy(), np.float32), observed.plane.unit)
    classes = Classes.whole(observed.specular_fraction.shape, metal=False)
    prediction = NetworkPrediction(light.residuals(maps), errors, confidence, None, classes)
    if estimate.basis is not None:
        return exemplar_of(observed, prediction)
    fitted = with_mean_parameters(observed, flattened(observed, prediction))
    return inpainted(exemplar_of(observed, fitted), observed)[0]


def _indexed(
    photo: Photo, exemplar: Exemplar, metal: Floats, waves: tuple[Wave, ...], mosaic: Mosaic
) -> tuple[Exemplar, Example, float]:
    """The exemplar, its index, and the factor on its albedo and F0 (mean_parameters.py)."""
    known = photo.flash_intensity is not None
    own = exemplar.cut(*mosaic.margins.inside(mosaic.size))
    scale = 1.0 if known else most_probable_scale(own, metal)
    exemplar = scaled(exemplar, scale).rounded()
    return *indexed(exemplar, waves, turned=photo.turned, one_light=False), scale
