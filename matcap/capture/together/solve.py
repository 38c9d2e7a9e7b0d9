"""Joint estimation of all maps from all photographs (photometric multi-view).

MAP estimate by Gauss-Newton steps on log radiance at every texel (texels.py). Geman-McClure weights
limit the influence of shadows, parallax and other outliers; the prior is Gaussian, with the
network's predictions as mean and its expected errors as standard deviation. The shared parameters
(gains, flash position, vignetting, mean F0 and roughness) are fitted between rounds to a sample of
texels (shared.py). Finally slopes are integrated to a height, and albedo is refitted to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.parameters import ALBEDO, F0, ROUGH
from matcap.capture.piece.smooth import smoothed
from matcap.capture.together.ambient_light import SLOW
from matcap.capture.together.octaves import denoised, prediction_error, with_energies
from matcap.capture.together.pair import scaled_by_ratio, with_ambient_gradient
from matcap.capture.together.shared import SAMPLED, shared_step
from matcap.capture.together.surface import surface_of
from matcap.capture.together.texels import (
    GLOSS,
    ROWS,
    SLOPES,
    Estimate,
    ParameterPrior,
    Stepped,
    log_rendered,
    maps_of,
    parameters_of,
    points_of,
    slopes_of,
    stepped,
    under_fitted_ambient,
)
from matcap.capture.together.views import ResampledView, SharedLight, light_at
from matcap.flash.light import strips

# Per-texel steps in each round; each begins with a fit of the shared parameters.
ROUNDS: tuple[int, ...] = (2, 2, 1)
# Least standard deviation of the prior of slopes, until the photographs measure the prediction's
# error; then the factor on that for each photograph: each octave's gain is estimated later
# (octaves.py), but noise of slopes from two photographs is in all of them. One without flash, which
# measures albedo alone, counts as five.
_SLOPE, _WIDER, _UNLIT = 1.0, 0.5, 5


@dataclass(frozen=True)
class Solved:
    """Maps that explain all photographs.

    Attributes:
        estimate: maps and their standard deviations.
        light: fitted shared parameters and gains.
        residual: (photographs,) median absolute residual of log radiance of each.
        measured: share of the posterior precision of log albedo, log F0, roughness and slopes that
            photographs contribute rather than the prior, in [0, 1]; medians over texels.
        prediction_error: standard deviation of the network's slopes, measured by the photographs.
        slope_energies: mean energies of slopes in the octaves above 4 texels, measured by them.
        interrupted: whether Ctrl-C ended the solve, with the best result so far.
    """

    estimate: Estimate
    light: SharedLight
    residual: tuple[float, ...]
    measured: tuple[float, ...]
    prediction_error: float
    slope_energies: tuple[float, ...]
    interrupted: bool = False

    @property
    def maps(self) -> MapSet:
        """The estimated maps."""
        return self.estimate.maps

    def slope_statistics_on(self, maps: MapSet) -> tuple[float, tuple[float, ...]]:
        """prediction_error and slope_energies on a grid as fine, or finer by whole octaves."""
        octaves = round(math.log2(maps.size[0] / self.maps.size[0]))
        return self.prediction_error, self.slope_energies[octaves:]


@torch.no_grad()
def solve(
    views: Sequence[ResampledView],
    prediction: Estimate,
    light: SharedLight,
    begun: Solved | None = None,
    on_progress: Callable[[float], None] = lambda _share: None,
    *,
    rounds: Sequence[int] = ROUNDS,
    sampled: int = SAMPLED,
) -> Solved:
    """Estimate the maps; an interrupt ends with the best so far.

    Args:
        views: photographs on the maps' grid, the first one first.
        prediction: the network's: mean and deviation of the prior.
        light: initial value.
        begun: solution on a coarser grid, to start from; None to start from the prediction.
        on_progress: called with the completed share, in [0, 1].
        rounds, sampled: see ROUNDS and shared.SAMPLED.
    """
    maps, texel_size = prediction.maps, prediction.maps.texel_size
    off, energies = begun.slope_statistics_on(maps) if begun else (0.0, ())
    prior = ParameterPrior.of(prediction).with_least_slope(off)
    parameters = prior.mean.clone() if begun is None else _continued(prior.mean, maps, begun)
    total, done, interrupted = sum(rounds) + 2, 0, False
    light = with_ambient_gradient(views, prior.mean, light)
    unit = views[0].extent.unit(parameters.shape[-1])
    lit, expected, step = list(views), prior, Stepped.none(parameters)
    wider = _WIDER * sum(1 if view.flash else _UNLIT for view in views)
    try:
        for index, steps in enumerate(rounds):
            lit, before = under_fitted_ambient(views, parameters, light), light.gloss
            light, _ = shared_step(lit, parameters, prior, light, sampled)
            parameters[GLOSS] += (light.gloss - before)[:, None, None]
            measures = begun is None and index == 0
            expected = prior.with_least_slope(_SLOPE if measures else wider * off)
            expected = expected.with_gloss_of(light)
            for turn in range(1, steps + 1):
                each = turn == steps and (measures or not rounds[index + 1 :])
                step = stepped(lit, parameters, expected, light, changed=SLOPES if each else None)
                parameters, done = step.parameters, done + 1
                on_progress(done / total)
            parameters[SLOPES] = _without_slow(parameters[SLOPES], unit)
            if measures:
                off, energies = _slope_statistics(parameters, prior.mean, step.changes)
                prior = prior.with_least_slope(off)
    except KeyboardInterrupt:
        interrupted = True
    height = surface_of(parameters[SLOPES], texel_size, step.relief)
    if not interrupted:
        height = _denoised(height, lit, step.changes, prior, energies)
        height = scaled_by_ratio(height, lit, parameters, light)
    parameters[SLOPES] = slopes_of(height, texel_size)
    if not interrupted:
        parameters = _step_at_fixed_slopes(lit, parameters, expected, light)
    maps, errors = maps_of(parameters, height, texel_size), _log_errors(step.precision, expected)
    residuals, shares = _residuals(lit, parameters, light), _shares(step.precision, expected)
    return Solved(Estimate(maps, errors), light, residuals, shares, off, energies, interrupted)


def _denoised(
    height: Tensor,
    views: Sequence[ResampledView],
    changes: Tensor,
    prior: ParameterPrior,
    slope_energies: Sequence[float],
) -> Tensor:
    """(1, H, W) height denoised octave by octave (octaves.py), plane units.

    Two photographs measure slopes along their baseline only, and across it those of the prior do
    not change when either is left out. The octaves' energies are then those that were measured with
    a wide prior (`slope_energies`).

    Args:
        height: (1, H, W), estimated from all photographs.
        views: the photographs.
        changes: (photographs, 2, H, W) change of slopes when each is left out (jackknife).
        prior: whose mean slopes are the network's.
        slope_energies: as Solved.slope_energies.
    """
    extent, across = views[0].extent, height.shape[-1]
    prediction, *others = (
        surface_of(_without_slow(slopes, extent.unit(across)), extent.texel(across))
        for slopes in (prior.mean[SLOPES], *changes)
    )
    jackknife = [other[0].numpy() for other in others]
    height_map = denoised(height[0].numpy(), prediction[0].numpy(), jackknife, keep_energy=True)
    if len(views) == 2 and views[1].flash:
        height_map = with_energies(height_map, extent.texel(across), slope_energies)
    return torch.from_numpy(height_map)[None]


def _continued(prior_mean: Tensor, prior: MapSet, begun: Solved) -> Tensor:
    """(PARAMETERS, H, W) prior mean plus upsampled (estimate - prior mean) of a coarse grid."""
    size = begun.maps.size[::-1]
    small = F.interpolate(prior.stacked()[None].float(), size=size, mode="area")[0]
    coarse = MapSet.from_stacked(small, begun.maps.texel_size)
    change = parameters_of(begun.maps) - parameters_of(coarse)
    return prior_mean + F.interpolate(change[None], size=prior_mean.shape[1:], mode="bilinear")[0]


def _without_slow(slopes: Tensor, unit: float) -> Tensor:
    """High-pass filtered slopes.

    Low frequencies contain errors of cameras and lights, and bend and tilt of the sample.
    """
    deviation = SLOW * unit
    slow = [torch.from_numpy(smoothed(plane, deviation)) for plane in slopes.numpy()]
    return slopes - torch.stack(slow)


def _step_at_fixed_slopes(
    views: Sequence[ResampledView],
    parameters: Tensor,
    prior: ParameterPrior,
    light: SharedLight,
) -> Tensor:
    """Parameters after a step with slopes fixed, albedo denoised (octaves.py)."""
    step = stepped(views, parameters, prior, light, slopes=False, changed=ALBEDO)
    for channel in range(3):
        measured, prediction, changes = (
            each.numpy()
            for each in (step.parameters[channel], prior.mean[channel], step.changes[:, channel])
        )
        step.parameters[channel] = torch.from_numpy(denoised(measured, prediction, changes))
    return step.parameters


def _slope_statistics(
    parameters: Tensor, prior_mean: Tensor, changes: Tensor
) -> tuple[float, tuple[float, ...]]:
    """Solved.prediction_error and Solved.slope_energies, means over both slopes (octaves.py)."""
    both = (parameters[SLOPES], prior_mean[SLOPES], changes.movedim(1, 0))
    of_each = (prediction_error(*(x.numpy() for x in each)) for each in zip(*both, strict=True))
    squares, energies = zip(*of_each, strict=True)
    return math.sqrt(np.mean(squares)), tuple(np.mean(energies, axis=0).tolist())


def _log_errors(precision: Tensor, prior: ParameterPrior) -> Tensor:
    """(4, H, W) log standard deviation of log albedo, log F0, logit roughness and slope."""
    # The precision of a parameter alone is optimistic: the others are correlated with it.
    deviation = (0.25 * precision + prior.precision).rsqrt()
    albedo, slope = deviation[ALBEDO].mean(0), deviation[SLOPES].mean(0)
    return torch.stack([albedo, deviation[F0], deviation[ROUGH], slope]).log()


def _shares(precision: Tensor, prior: ParameterPrior) -> tuple[float, ...]:
    """Photographs' share in the posterior precision of each map, median over texels."""
    share = precision / (precision + prior.precision)
    return tuple(share[part].flatten().median().item() for part in (ALBEDO, F0, ROUGH, SLOPES))


def _residuals(
    views: Sequence[ResampledView], parameters: Tensor, light: SharedLight
) -> tuple[float, ...]:
    """Median absolute residual of log radiance of each photograph, from a quarter of the rows."""
    off: list[list[Tensor]] = [[] for _ in views]
    for rows in strips(parameters.shape[1], ROWS // 4)[::4]:
        points = points_of(parameters.shape[-2:], rows, views[0].extent)
        lit = [light_at(k, view, light, points) for k, view in enumerate(views)]
        shown = log_rendered(parameters[:, rows], lit)
        for view, left, log in zip(views, off, shown, strict=True):
            left.append((view.log[:, rows] - log)[view.seen[:, rows]].abs())
    every = (torch.cat(each) for each in off)
    return tuple(float(each.median()) if each.numel() else math.nan for each in every)
