"""Joint estimation of all maps from all photographs (photometric multi-view).

Per texel Gauss-Newton steps on log radiance, robust against shadows, parallax and what no
reflectance explains (Geman and McClure's weights), held by what the network read from the first
photograph, with its own doubt (texels.py). Between rounds, what all texels share is found from some
of them (shared.py). Gloss is measured where a highlight crosses: elsewhere it is interpolated,
weighted by precision. At last slopes become a surface, and albedo and gloss follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.piece.smooth import smoothed
from matcap.capture.together.octaves import denoised, read_error
from matcap.capture.together.shared import shared_light
from matcap.capture.together.surface import surface_of
from matcap.capture.together.texels import (
    ALBEDO,
    F0,
    GLOSS,
    ROUGH,
    SLOPES,
    SolveSettings,
    Stepped,
    levelled,
    maps_of,
    numbers_of,
    points_of,
    rendered,
    slopes_of,
    spread_of,
    stepped,
    under_room,
)
from matcap.capture.together.views import PieceView, SetLight, light_at, strips


@dataclass(frozen=True)
class Solved:
    """Maps that explain all photographs.

    Attributes:
        maps: the piece's.
        errors: (4, H, W) log of the deviation of log albedo, log F0, logit roughness and slope.
        light: of all photographs, as found.
        residual: (photographs,) median difference of log radiance of what each shows.
        measured: share of the posterior precision of log albedo, log F0, roughness and slopes that
            photographs contribute rather than the prior, in [0, 1]; medians over texels.
        read_off: standard deviation of predicted slopes, measured by the photographs.
        interrupted: ended early, with the best so far.
    """

    maps: MapSet
    errors: Tensor
    light: SetLight
    residual: tuple[float, ...]
    measured: tuple[float, float, float, float]
    read_off: float
    interrupted: bool = False


@torch.no_grad()
def solve(
    views: Sequence[PieceView],
    prior: MapSet,
    doubt: Tensor,
    light: SetLight,
    *,
    radiometric: bool,
    settings: SolveSettings | None = None,
    on_progress: Callable[[float], None] | None = None,
    begun: Solved | None = None,
) -> Solved:
    """Estimate the maps; an interrupt ends with the best so far.

    Args:
        views: of the piece, the first photograph first, on the maps' grid.
        prior: what the network read from the first photograph.
        doubt: (4, H, W) log of what that is expected to be off by: log albedo, log F0, logit
            roughness, slope.
        light: a first guess.
        radiometric: whether all are RAW: vignetting is then held at none.
        settings: see SolveSettings.
        on_progress: called with the share that is done.
        begun: the same piece solved on fewer texels: where texels begin, in place of what was read.
    """
    settings, on_progress = settings or SolveSettings(), on_progress or (lambda _share: None)
    return _solve(views, (prior, doubt), light, radiometric, settings, on_progress, begun)


def _solve(
    given: Sequence[PieceView],
    read: tuple[MapSet, Tensor],
    light: SetLight,
    radiometric: bool,
    settings: SolveSettings,
    on_progress: Callable[[float], None],
    begun: Solved | None,
) -> Solved:
    """As solve, of what was read and its doubts."""
    (prior, doubt), prior_mean = read, numbers_of(read[0])
    views, spread = under_room(given, prior_mean), spread_of(doubt, settings)
    if not settings.rounds:
        light = shared_light(views, prior_mean, prior_mean, spread, light, radiometric, settings)
    # Of the light, which a common error of slopes would move, and of texels.
    off = 0.0 if begun is None else begun.read_off
    known = _with_least_slope(spread, off)
    fresh = begun is None and len(settings.rounds) > 0
    spread = _with_least_slope(spread, settings.slope if fresh else settings.wider * off)
    numbers = prior_mean.clone() if begun is None else _continued(prior_mean, prior, begun)
    unit = views[0].extent.unit(numbers.shape[-1])
    precision, total, done, interrupted = torch.zeros(()), sum(settings.rounds) + 2, 0, False
    step: Stepped | None = None
    try:
        for index, steps in enumerate(settings.rounds):
            views = under_room(given, numbers)
            before = light.gloss
            light = shared_light(views, numbers, prior_mean, known, light, radiometric, settings)
            numbers[GLOSS] += (light.gloss - before)[:, None, None]
            expected = levelled(prior_mean, light)
            for turn in range(1, steps + 1):
                each = turn == steps and (
                    index == len(settings.rounds) - 1 or (not index and fresh)
                )
                step = stepped(views, numbers, expected, spread, light, settings, without_each=each)
                numbers, precision = step.numbers, step.precision
                done += 1
                on_progress(done / total)
            numbers[SLOPES] = _without_slow(numbers[SLOPES], unit, settings)
            if index == 0 and step is not None:
                if fresh:
                    off = _read_off(numbers, prior_mean, step.changes)
                    spread = _with_least_slope(known, settings.wider * off)
                    known = _with_least_slope(known, off)
                prior_mean = _gloss_prior(prior_mean, numbers - expected, precision, unit, settings)
    except KeyboardInterrupt:
        interrupted = True
    height = surface_of(numbers[SLOPES], prior.texel_size, None if step is None else step.relief)
    if step is not None and not interrupted:
        every = [prior_mean[SLOPES], *step.changes[:, SLOPES]]
        slow = (_without_slow(each, unit, settings) for each in every)
        calm, *changes = (surface_of(each, prior.texel_size)[0].numpy() for each in slow)
        height[0] = torch.from_numpy(denoised(height[0].numpy(), calm, changes, drawn=True))
        numbers[SLOPES] = slopes_of(height, prior.texel_size)
        numbers = _step_at_fixed_slopes(views, numbers, expected, spread, light, settings)
    numbers[SLOPES] = slopes_of(height, prior.texel_size)
    errors = _errors(precision, spread)
    maps = maps_of(numbers, height, prior.texel_size)
    left, shares = _residuals(views, numbers, light, settings), _measured_shares(precision, spread)
    return Solved(maps, errors, light, left, shares, off, interrupted)


def _with_least_slope(spread: Tensor, slope: float) -> Tensor:
    """(NUMBERS, H, W) deviations of a prior, those of slopes no less than one."""
    spread = spread.clone()
    spread[SLOPES] = spread[SLOPES].clamp_min(slope)
    return spread


def _continued(prior_mean: Tensor, prior: MapSet, begun: Solved) -> Tensor:
    """Numbers of a finer grid: what a coarser one changed of what was read, and its fine bands."""
    size = begun.maps.size[::-1]
    small = F.interpolate(prior.stacked()[None].float(), size=size, mode="area")[0]
    change = numbers_of(begun.maps) - numbers_of(MapSet.from_stacked(small, begun.maps.texel_size))
    return prior_mean + F.interpolate(change[None], size=prior_mean.shape[1:], mode="bilinear")[0]


def predicted(view: PieceView, solved: Solved) -> float:
    """Median difference of log radiance of a photograph that had no part in the maps.

    Its gain and balance are its own and are fitted first.
    """
    numbers = numbers_of(solved.maps)
    size = view.log.shape[-2:]
    light = replace(solved.light, gain=torch.zeros(1, 3))
    shown = rendered(numbers, [light_at(0, view, light, points_of(size, extent=view.extent))])[
        0
    ].log()
    off = view.log - shown
    for channel in range(3):
        residual = off[channel][view.seen[channel]]
        if residual.numel():
            off[channel] -= residual.median()
    residual = off[view.seen]
    return float(residual.abs().median()) if residual.numel() else math.nan


def _without_slow(slopes: Tensor, unit: float, settings: SolveSettings) -> Tensor:
    """Slopes without low frequencies, which absorb small errors of cameras and lights.

    A sheet that lies bent or leans is no relief of its material either.
    """
    deviation = settings.slow * unit
    slow = [torch.from_numpy(smoothed(plane, deviation)) for plane in slopes.numpy()]
    return slopes - torch.stack(slow)


def _gloss_prior(
    prior_mean: Tensor,
    off: Tensor,
    precision: Tensor,
    unit: float,
    settings: SolveSettings,
) -> Tensor:
    """Prior of F0 and roughness: the mean of neighbouring estimates, weighted by their precision.

    Args:
        prior_mean: (NUMBERS, H, W) so far.
        off: likewise, what numbers are off by from it.
        precision: likewise, of each parameter by the photographs.
        unit: texels of the long side.
        settings: see SolveSettings.
    """
    prior_mean = prior_mean.clone()
    deviation = settings.around * unit
    for number in (F0, ROUGH):
        measured = precision[number].numpy()
        weight = measured / (measured + float(np.median(measured)) + 1e-6)
        change = off[number].numpy()
        near, amount = (
            cv2.GaussianBlur(plane, (0, 0), deviation, borderType=cv2.BORDER_REFLECT)
            for plane in (change * weight, weight)
        )
        whole = float((change * weight).sum() / max(float(weight.sum()), 1e-6))
        prior_mean[number] += torch.from_numpy((near + 0.05 * whole) / (amount + 0.05))
    return prior_mean


def _step_at_fixed_slopes(
    views: Sequence[PieceView],
    numbers: Tensor,
    prior_mean: Tensor,
    spread: Tensor,
    light: SetLight,
    settings: SolveSettings,
) -> Tensor:
    """Parameters after a step with slopes fixed, albedo denoised (octaves.py)."""
    tight_spread, tight_mean = spread.clone(), prior_mean.clone()
    tight_spread[SLOPES] = 1e-4
    tight_mean[SLOPES] = numbers[SLOPES]
    step = stepped(views, numbers, tight_mean, tight_spread, light, settings, without_each=True)
    for channel in range(3):
        measured, read, changes = (
            each.numpy()
            for each in (step.numbers[channel], prior_mean[channel], step.changes[:, channel])
        )
        step.numbers[channel] = torch.from_numpy(denoised(measured, read, changes))
    return step.numbers


def _read_off(numbers: Tensor, prior_mean: Tensor, changes: Tensor) -> float:
    """Standard deviation of predicted slopes, measured by the photographs."""
    squares = [
        read_error(numbers[k].numpy(), prior_mean[k].numpy(), changes[:, k].numpy())
        for k in range(SLOPES.start, SLOPES.stop)
    ]
    return math.sqrt(sum(squares) / len(squares))


def _errors(precision: Tensor, spread: Tensor) -> Tensor:
    """(4, H, W) log deviations of log albedo, log F0, logit roughness and slope."""
    if precision.ndim == 0:
        precision = torch.zeros_like(spread)
    # The precision of a parameter alone is optimistic: the others are correlated with it.
    deviation = (0.25 * precision + spread.square().reciprocal()).rsqrt()
    return torch.stack(
        [
            deviation[ALBEDO].mean(0),
            deviation[F0],
            deviation[ROUGH],
            deviation[SLOPES].mean(0),
        ]
    ).log()


def _measured_shares(precision: Tensor, spread: Tensor) -> tuple[float, float, float, float]:
    if precision.ndim == 0:
        return (0.0, 0.0, 0.0, 0.0)
    share = precision / (precision + spread.square().reciprocal())
    every = [share[part].flatten().median().item() for part in (ALBEDO, F0, ROUGH, SLOPES)]
    return every[0], every[1], every[2], every[3]


def _residuals(
    views: Sequence[PieceView], numbers: Tensor, light: SetLight, settings: SolveSettings
) -> tuple[float, ...]:
    left = []
    for k, view in enumerate(views):
        off = []
        for rows in strips(numbers.shape[1], settings.rows):
            points = points_of(numbers.shape[-2:], rows, view.extent)
            lit = light_at(k, view, light, points)
            shown = rendered(numbers[:, rows], [lit])[0].log()
            off.append((view.log[:, rows] - shown)[view.seen[:, rows]].abs())
        every = torch.cat(off)
        left.append(float(every.median()) if every.numel() else math.nan)
    return tuple(left)
