"""All maps of a piece under all its photographs' lights at once.

Per texel Gauss-Newton steps on log radiance, robust against shadows, parallax and what no
reflectance explains (Geman and McClure's weights), held by what the network read from the first
photograph, with its own doubt (texels.py). Between rounds, what all texels share is found from some
of them (shared.py). Gloss shows where a highlight crosses: elsewhere it is believed to be as it is
around, weighted by what was told. At last slopes become a surface, and albedo and gloss follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.piece.smooth import smoothed
from matcap.capture.together.shared import shared_light
from matcap.capture.together.surface import surface_of
from matcap.capture.together.texels import (
    ALBEDO,
    F0,
    ROUGH,
    SLOPES,
    SolveSettings,
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
        told: share of what is known of log albedo, log F0, roughness and slopes that photographs
            tell, and the prior does not; medians over texels.
        interrupted: ended early, with the best so far.
    """

    maps: MapSet
    errors: Tensor
    light: SetLight
    residual: tuple[float, ...]
    told: tuple[float, float, float, float]
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
    tell: Callable[[float], None] | None = None,
    begun: Solved | None = None,
) -> Solved:
    """Find the maps; an interrupt ends with the best so far.

    Args:
        views: of the piece, the first photograph first, on the maps' grid.
        prior: what the network read from the first photograph.
        doubt: (4, H, W) log of what that is expected to be off by: log albedo, log F0, logit
            roughness, slope.
        light: a first guess.
        radiometric: whether all are RAW: vignetting is then held at none.
        settings: see SolveSettings.
        tell: called with the share that is done.
        begun: the same piece solved on fewer texels: where texels begin, in place of what was read.
    """
    settings = settings or SolveSettings()
    given, believed = views, numbers_of(prior)
    views = under_room(given, believed)
    spread = spread_of(doubt, settings)
    if not settings.rounds:
        light = shared_light(views, believed, believed, spread, light, radiometric, settings)
    numbers = believed.clone() if begun is None else _continued(believed, prior, begun)
    unit = views[0].extent.unit(numbers.shape[-1])
    precision, total, done, interrupted = torch.zeros(()), sum(settings.rounds) + 2, 0, False
    relief: Tensor | None = None
    try:
        for index, steps in enumerate(settings.rounds):
            views = under_room(given, numbers)
            light = shared_light(views, numbers, believed, spread, light, radiometric, settings)
            for _ in range(steps):
                step = stepped(views, numbers, believed, spread, light, settings)
                numbers, precision, relief = step.numbers, step.told, step.relief
                done += 1
                if tell:
                    tell(done / total)
            numbers[SLOPES] = _without_slow(numbers[SLOPES], unit, settings)
            if index == 0:
                told = believed, spread, numbers, precision
                believed, spread = _told_around(*told, unit, settings)
    except KeyboardInterrupt:
        interrupted = True
    height = surface_of(numbers[SLOPES], prior.texel_size, relief)
    numbers[SLOPES] = slopes_of(height, prior.texel_size)
    if settings.rounds and not interrupted:
        numbers = _answering(views, numbers, believed, spread, light, settings)
        numbers[SLOPES] = slopes_of(height, prior.texel_size)
    errors = _errors(precision, spread)
    maps = maps_of(numbers, height, prior.texel_size)
    residuals = _residuals(views, numbers, light, settings)
    return Solved(maps, errors, light, residuals, _told(precision, spread), interrupted)


def _continued(believed: Tensor, prior: MapSet, begun: Solved) -> Tensor:
    """Numbers of a finer grid: what a coarser one changed of what was read, and its fine bands."""
    size = begun.maps.size[::-1]
    small = F.interpolate(prior.stacked()[None].float(), size=size, mode="area")[0]
    change = numbers_of(begun.maps) - numbers_of(MapSet.from_stacked(small, begun.maps.texel_size))
    return believed + F.interpolate(change[None], size=believed.shape[1:], mode="bilinear")[0]


def predicted(view: PieceView, solved: Solved) -> float:
    """Median difference of log radiance of a photograph that had no part in the maps.

    Its gain and balance are its own and are fitted first.
    """
    numbers = numbers_of(solved.maps)
    size = view.log.shape[-2:]
    light = replace(solved.light, gain=torch.zeros(1, 3))
    found = rendered(numbers, [light_at(0, view, light, points_of(size, extent=view.extent))])[
        0
    ].log()
    off = view.log - found
    for channel in range(3):
        told = off[channel][view.seen[channel]]
        if told.numel():
            off[channel] -= told.median()
    told = off[view.seen]
    return float(told.abs().median()) if told.numel() else math.nan


def _without_slow(slopes: Tensor, unit: float, settings: SolveSettings) -> Tensor:
    """Slopes less what of them is slow, which cameras and lights a little beside their places tell.

    A sheet that lies bent or leans is no relief of its material either.
    """
    deviation = settings.slow * unit
    slow = [torch.from_numpy(smoothed(plane, deviation)) for plane in slopes.numpy()]
    return slopes - torch.stack(slow)


def _told_around(
    believed: Tensor,
    spread: Tensor,
    numbers: Tensor,
    precision: Tensor,
    unit: float,
    settings: SolveSettings,
) -> tuple[Tensor, Tensor]:
    """A prior of gloss from what was told of it around, however little of it was told here."""
    believed, spread = believed.clone(), spread.clone()
    deviation = settings.around * unit
    for number in (F0, ROUGH):
        told = precision[number].numpy()
        weight = told / (told + float(np.median(told)) + 1e-6)
        off = (numbers[number] - believed[number]).numpy()
        near, amount = (
            cv2.GaussianBlur(plane, (0, 0), deviation, borderType=cv2.BORDER_REFLECT)
            for plane in (off * weight, weight)
        )
        whole = float((off * weight).sum() / max(float(weight.sum()), 1e-6))
        change: NDArray[np.float32] = (near + 0.05 * whole) / (amount + 0.05)
        believed[number] += torch.from_numpy(change)
    return believed, spread


def _answering(
    views: Sequence[PieceView],
    numbers: Tensor,
    believed: Tensor,
    spread: Tensor,
    light: SetLight,
    settings: SolveSettings,
) -> Tensor:
    """Numbers after a step in which slopes stay as they are."""
    held, held_to = spread.clone(), believed.clone()
    held[SLOPES] = 1e-4
    held_to[SLOPES] = numbers[SLOPES]
    return stepped(views, numbers, held_to, held, light, settings).numbers


def _errors(precision: Tensor, spread: Tensor) -> Tensor:
    """(4, H, W) log deviations of log albedo, log F0, logit roughness and slope."""
    if precision.ndim == 0:
        precision = torch.zeros_like(spread)
    # What is told of one number alone flatters: others could do the same.
    deviation = (0.25 * precision + spread.square().reciprocal()).rsqrt()
    return torch.stack(
        [
            deviation[ALBEDO].mean(0),
            deviation[F0],
            deviation[ROUGH],
            deviation[SLOPES].mean(0),
        ]
    ).log()


def _told(precision: Tensor, spread: Tensor) -> tuple[float, float, float, float]:
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
            found = rendered(numbers[:, rows], [lit])[0].log()
            off.append((view.log[:, rows] - found)[view.seen[:, rows]].abs())
        every = torch.cat(off)
        left.append(float(every.median()) if every.numel() else math.nan)
    return tuple(left)
