"""Joint estimation of all maps from all photographs (photometric multi-view [woodham1980]).

MAP estimate by Gauss-Newton steps on log radiance at every texel (texels.py). Geman-McClure weights
limit the influence of shadows, parallax and other outliers; the prior is Gaussian, with the
network's predictions as mean and its expected errors as standard deviation. The shared parameters
(gains, flash position, vignetting, mean F0 and roughness) are fitted between rounds to a sample of
texels (shared.py). Finally slopes are integrated to a height, and albedo is refitted to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import ALBEDO, F0, ROUGH
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.octaves import smoothed
from matcap.capture.multiview.pair import scaled_by_ratio, with_ambient_gradient
from matcap.capture.multiview.shared import SAMPLED, shared_step
from matcap.capture.multiview.surface import (
    cross_energies,
    denoised,
    integrated,
    prediction_error,
    surface_of,
    with_energies,
)
from matcap.capture.multiview.texels import (
    SLOPES,
    Estimate,
    ParameterPrior,
    Stepped,
    log_rendered,
    maps_of,
    parameters_of,
    slopes_of,
    stepped,
    under_fitted_ambient,
    with_gloss,
)
from matcap.capture.multiview.views import SLOW, Resampled, SharedLight, light_at
from matcap.flash.geometry import points_of
from matcap.flash.light import strips

# Per-texel steps in each round; each begins with a fit of the shared parameters.
ROUNDS: tuple[int, ...] = (2, 2, 1)
# Prior standard deviation of slopes until the photographs have measured the error of the
# prediction. It is wide, as each octave's gain is estimated afterwards (surface.py).
_SLOPE = 1.0
# The same of several materials: where gloss is strong, a slope explains any radiance.
_GLOSSY_SLOPE, _GLOSSY_WIDER = 0.05, 1.0
# Then that deviation over the measured error is the number of photographs less one, of several at
# least _WIDER: it is the same for all wavelengths, and errors are long waves, which a narrow prior
# holds back to the network's. One without flash, which measures albedo, counts as five.
_WIDER, _UNLIT = 4.0, 5
# Noise variance of two photographs' relief below 4 texels over the jackknife's, as of six sets.
_UNDERSTATED = 4.0
_SPREAD = 1.4826  # of Gaussian residuals, standard deviation over median absolute value


@dataclass(frozen=True)
class Solved:
    """Maps that explain all photographs."""

    estimate: Estimate
    """Maps and their standard deviations."""
    light: SharedLight
    """Fitted shared parameters and gains."""
    residual: tuple[float, ...]
    """(photographs,) median absolute residual of log radiance of each."""
    measured: tuple[float, ...]
    """Share of the posterior precision of log albedo, log F0, roughness and slopes that photographs
    contribute rather than the prior, in [0, 1]; medians over texels."""
    prediction_error: float
    """Standard deviation of the network's slopes, measured by the photographs."""
    slope_energies: tuple[float, ...]
    """Mean energies of slopes in the octaves above 4 texels, measured by them."""
    interrupted: bool = False
    """Whether Ctrl-C ended the solve, with the best result so far."""

    @property
    def maps(self) -> MapSet:
        """The estimated maps."""
        return self.estimate.maps

    def slope_statistics_on(self, maps: MapSet) -> tuple[float, tuple[float, ...]]:
        """prediction_error and slope_energies on a grid as fine, or finer by whole octaves."""
        octaves = round(math.log2(maps.size[0] / self.maps.size[0]))
        return self.prediction_error, self.slope_energies[octaves:]


@dataclass(frozen=True)
class _Iterate:
    """The solution after a Gauss-Newton step."""

    views: Resampled
    """Photographs; of the ambient one, low frequencies are those of the rendered maps."""
    light: SharedLight
    """Fitted shared parameters."""
    prior: ParameterPrior
    """Prediction; the deviation of slopes is at least the measured error."""
    widened: ParameterPrior
    """The prior of this round."""
    step: Stepped
    """Parameters, their precision, and jackknife changes of slopes after the last step."""
    prediction_error: float
    slope_energies: tuple[float, ...]
    """As in Solved."""

    @staticmethod
    def initial(
        views: Resampled, prediction: Estimate, light: SharedLight, coarser: Solved | None
    ) -> _Iterate:
        """The prediction, or the upsampled solution of a coarser grid; arguments as of solve."""
        prior, error, energies = ParameterPrior.of(prediction), 0.0, tuple[float, ...]()
        parameters = prior.mean.clone()
        if coarser is not None:
            parameters = _continued(prior.mean, prediction.maps, coarser)
            error, energies = coarser.slope_statistics_on(prediction.maps)
        prior, gloss = prior.with_least(SLOPES, error), prior.gloss_deviation
        if light.gloss.shape != gloss.shape:
            light = replace(light, gloss=torch.zeros_like(gloss))
        light = with_ambient_gradient(views, prior.mean, light)
        return _Iterate(views, light, prior, prior, Stepped.none(parameters), error, energies)

    def with_noise(self, *, solved: bool) -> _Iterate:
        """With the noise of log radiance by channel that residuals show, of one material.

        JPEG's noise differs from set to set tenfold, and contrast that maps cannot have, as that
        of glints below a texel, counts as noise.

        Args:
            solved: whether texels are fitted to all photographs of this grid, three albedos and
                the slopes that they tell; else to the first, which differs from each of the others
                by the noise of both.
        """
        count = len(self.views)
        if count < 2 or len(self.prior.shares) > 1 or not all(v.flash for v in self.views):
            return self
        free = 3 * count - 3 - min(2, count - 1)
        share = 3 * count / free if solved else count / (2.0 * count - 2.0)
        off = _residuals(self.views, self.step.parameters, self.light)
        medians = torch.stack([each.nanmedian(dim=1).values.nan_to_num(0.0) for each in off])
        variance = _SPREAD**2 * share * medians.square().mean(0)[:, None, None]
        views = [replace(view, measured_variance=variance) for view in self.views]
        return replace(self, views=views)

    def with_shared(self, slope: float, sampled: int) -> _Iterate:
        """Begin a round: fit the shared parameters.

        Args:
            slope: least prior standard deviation of slopes in this round.
            sampled: texels to which the shared parameters are fitted.
        """
        parameters, widened = self.step.parameters, self.prior.with_least(SLOPES, slope)
        views = under_fitted_ambient(self.views, parameters, self.light)
        # Two photographs do not tell gloss from slopes; several materials have told it (basis.py).
        narrow = len(self.prior.shares) > 1 or len(views) < 3
        free = self.prior if narrow else widened
        light, _ = shared_step(views, parameters, free, self.light, sampled)
        parameters = with_gloss(parameters, self.prior.shares, light.gloss - self.light.gloss)
        step = replace(self.step, parameters=parameters)
        widened = widened.with_gloss_of(light)
        return replace(self, views=views, light=light, widened=widened, step=step)

    def stepped(self, *, jackknife: bool) -> _Iterate:
        """A Gauss-Newton step of all texels."""
        changed = SLOPES if jackknife else None
        parameters = self.step.parameters
        step = stepped(self.views, parameters, self.widened, self.light, changed=changed)
        return replace(self, step=step)

    def high_passed(self) -> _Iterate:
        """End a round: remove low frequencies of slopes."""
        parameters, extent = self.step.parameters.clone(), self.views[0].extent
        unit = extent.unit(parameters.shape[-1])
        parameters[SLOPES] = _without_slow(parameters[SLOPES], unit)
        return replace(self, step=replace(self.step, parameters=parameters))

    def measured(self) -> _Iterate:
        """Measure error and energies of the predicted slopes, means over both slopes."""
        changes = self.step.changes.movedim(1, 0)
        each = zip(self.step.parameters[SLOPES], self.prior.mean[SLOPES], changes, strict=True)
        of_each = (prediction_error(*(plane.numpy() for plane in planes)) for planes in each)
        squares, energies = zip(*of_each, strict=True)
        error = math.sqrt(np.mean(squares))
        return replace(
            self,
            prior=self.prior.with_least(SLOPES, error),
            prediction_error=error,
            slope_energies=tuple(np.mean(energies, axis=0).tolist()),
        )


@torch.no_grad()
def solve(
    views: Resampled,
    prediction: Estimate,
    light: SharedLight,
    coarser: Solved | None = None,
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
        coarser: solution on a coarser grid, to start from; None to start from the prediction.
        on_progress: called with the completed share, in [0, 1].
        rounds, sampled: see ROUNDS and shared.SAMPLED.
    """
    iterate, interrupted = _Iterate.initial(views, prediction, light, coarser), False
    try:
        steps = _iterates(iterate, rounds, sampled, measure=coarser is None)
        for done, newest in enumerate(steps, 1):
            iterate = newest
            on_progress(done / (sum(rounds) + 2))
    except KeyboardInterrupt:
        interrupted = True
    views, light, parameters = iterate.views, iterate.light, iterate.step.parameters
    texel_size = prediction.maps.texel_size
    height = surface_of(parameters[SLOPES], texel_size, iterate.step.relief)
    if not interrupted:
        height = scaled_by_ratio(_denoised(height, iterate), views, parameters, light)
    parameters[SLOPES] = slopes_of(height, texel_size)
    if not interrupted:
        parameters = _step_at_fixed_slopes(views, parameters, iterate.widened, light)
    precision, prior = iterate.step.precision, iterate.widened
    share = precision / (precision + prior.precision)
    return Solved(
        Estimate(
            maps_of(parameters, height, texel_size),
            _log_errors(precision, prior),
            prediction.basis and prediction.basis.changed(light.gloss),
        ),
        light,
        tuple(float(each.nanmedian()) for each in _residuals(views, parameters, light)),
        tuple(share[part].median().item() for part in (ALBEDO, F0, ROUGH, SLOPES)),
        iterate.prediction_error,
        iterate.slope_energies,
        interrupted,
    )


def _iterates(
    iterate: _Iterate, rounds: Sequence[int], sampled: int, *, measure: bool
) -> Iterator[_Iterate]:
    """The solution after each step of each round.

    Args:
        iterate: the initial one.
        rounds, sampled: as of solve.
        measure: whether the first round measures the error of the predicted slopes.
    """
    others = sum(1.0 if view.flash else _UNLIT for view in iterate.views) - 1.0
    first, wider = _SLOPE, max(others, _WIDER) if others else 0.0
    if len(iterate.prior.shares) > 1:
        first, wider = _GLOSSY_SLOPE, _GLOSSY_WIDER
    for index, steps in enumerate(rounds):
        measures = measure and index == 0
        slope = first if measures else wider * iterate.prediction_error
        iterate = iterate if measures else iterate.with_noise(solved=index > 0)
        iterate = iterate.with_shared(slope, sampled)
        for _ in range(steps - 1):
            iterate = iterate.stepped(jackknife=False)
            yield iterate
        jackknife = measures or index == len(rounds) - 1
        iterate = iterate.stepped(jackknife=jackknife).high_passed()
        if measures:
            iterate = iterate.measured()
        yield iterate


def _denoised(height: Tensor, iterate: _Iterate) -> Tensor:
    """(1, H, W) height denoised octave by octave (surface.py), plane units.

    Two photographs measure slopes along their baseline only, and across it those of the prior do
    not change when either is left out. The octaves' energies are then those that were measured with
    a wide prior (Solved.slope_energies).
    """
    views, extent, across = iterate.views, iterate.views[0].extent, height.shape[-1]
    texel_size, unit = extent.texel(across), extent.unit(across)

    def heights(slopes: Iterable[Tensor]) -> list[NDArray[np.float32]]:
        slow = (_without_slow(each, unit) for each in slopes)
        return [integrated(each, texel_size)[0].numpy() for each in slow]

    prediction, *jackknife = heights([iterate.prior.mean[SLOPES], *iterate.step.changes])
    two = len(views) == 2 and views[1].flash
    noise = _UNDERSTATED if two else 1.0
    result = denoised(height[0].numpy(), prediction, jackknife, understated=noise)
    if two:
        result = with_energies(result, texel_size, iterate.slope_energies)
    if len(iterate.step.halves):
        one, other = heights(iterate.step.halves)
        result = with_energies(result, texel_size, cross_energies(one, other, texel_size))
    return torch.from_numpy(result)[None]


def _continued(prior_mean: Tensor, prior: MapSet, coarser: Solved) -> Tensor:
    """(PARAMETERS, H, W) prior mean plus upsampled (estimate - prior mean) of a coarse grid."""
    size = coarser.maps.size[::-1]
    small = functional.interpolate(prior.stacked()[None].float(), size=size, mode="area")[0]
    coarse = MapSet.from_stacked(small, coarser.maps.texel_size)
    change = parameters_of(coarser.maps) - parameters_of(coarse)
    wide = functional.interpolate(change[None], size=prior_mean.shape[1:], mode="bilinear")[0]
    return prior_mean + wide


def _without_slow(slopes: Tensor, unit: float) -> Tensor:
    """High-pass filtered slopes.

    Low frequencies contain errors of cameras and lights, and bend and tilt of the sample.
    """
    deviation = SLOW * unit
    slow = [torch.from_numpy(smoothed(plane, deviation)) for plane in slopes.numpy()]
    return slopes - torch.stack(slow)


def _step_at_fixed_slopes(
    views: Resampled, parameters: Tensor, prior: ParameterPrior, light: SharedLight
) -> Tensor:
    """Parameters after a step with slopes fixed, albedo denoised (surface.py)."""
    step = stepped(views, parameters, prior, light, slopes=False, changed=ALBEDO)
    for channel in range(3):
        measured, prediction, changes = (
            each.numpy()
            for each in (step.parameters[channel], prior.mean[channel], step.changes[:, channel])
        )
        step.parameters[channel] = torch.from_numpy(denoised(measured, prediction, changes))
    return step.parameters


def _log_errors(precision: Tensor, prior: ParameterPrior) -> Tensor:
    """(4, H, W) log standard deviation of log albedo, log F0, logit roughness and slope."""
    # The precision of a parameter alone is optimistic: the others are correlated with it.
    deviation = (0.25 * precision + prior.precision).rsqrt()
    albedo, slope = deviation[ALBEDO].mean(0), deviation[SLOPES].mean(0)
    return torch.stack([albedo, deviation[F0], deviation[ROUGH], slope]).log()


def _residuals(views: Resampled, parameters: Tensor, light: SharedLight) -> tuple[Tensor, ...]:
    """(3, n) absolute residuals of log radiance of each photograph, from a quarter of the rows.

    NaN where it is not seen.
    """
    residuals: list[list[Tensor]] = [[] for _ in views]
    for rows in strips(parameters.shape[1], 12)[::4]:
        points = points_of(parameters.shape[-2:], rows, views[0].extent)
        lights = [light_at(k, view, light, points) for k, view in enumerate(views)]
        rendered = log_rendered(parameters[:, rows], lights)
        for view, residual, log in zip(views, residuals, rendered, strict=True):
            off = (view.log[:, rows] - log).abs().where(view.seen[:, rows], torch.nan)
            residual.append(off.flatten(1))
    return tuple(torch.cat(each, dim=1) for each in residuals)
