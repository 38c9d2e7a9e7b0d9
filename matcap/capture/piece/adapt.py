"""Adaptation: a piece of the exemplar, put anywhere, must look like the photograph there.

The network gets the drawing right and strengths wrong: how bright, glossy and deep, and by how much
each varies. The paper holds its decoder to the photograph by statistics of renderings at the
photograph's places (4.6). The same holds the exemplar: its windows are lit as if they lay
elsewhere, compared with what is seen there, and a few numbers that scale its maps as a whole are
moved until they agree. So few numbers need few steps, and cannot draw what was not photographed.

Gloss shows near the highlight alone, and there in statistics more than texel by texel. So among the
numbers is how F0 and roughness go with lightness and with relief: grooves are rougher than ridges.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.piece.smooth import split
from matcap.capture.piece.ties import ties
from matcap.flash.adam import Adam
from matcap.flash.likeness import PhotographTarget, compare_windows, render_windows, shuffled
from matcap.flash.penalty import Penalties, price
from matcap.flash.schedule import Schedule

_RATE = 0.06  # of Adam, in logits and in logarithms of gains
_BETAS = (0.8, 0.95)  # of Adam: short memories, for there are few steps
_PLACES = 3  # windows a step, of exemplar and of photograph
_HELD = 0.5  # share of the steps after which the rate falls to nothing, and numbers are averaged
# How far the numbers are believed to be off: offsets in logits of albedo, F0 and roughness;
# logarithms of gains of the same, of all relief, and of its bands beside.
_OFFSETS = (0.3, 0.3, 0.3, 0.5, 0.5)
_GAINS = (0.3, 0.7, 0.7)
_RELIEF, _BANDS = 0.5, 0.3
_BELIEF = 0.005  # of the distance of statistics, for a number that is off by its deviation
_LOGIT_EPSILON = 1e-4  # of albedo, F0 and roughness: bounds the logit at 0 and 1
_SEEN = 0.95  # share of a window that must have been seen; of the best windows, if none has
# Specks are what was photographed, here.
_PENALTIES = Penalties(outlier=0.0)


@dataclass(frozen=True)
class Adapted:
    """Adapted maps.

    Attributes:
        maps: of the photographed piece.
        interrupted: ended by Ctrl-C, with the numbers so far.
    """

    maps: MapSet
    interrupted: bool = False


@torch.enable_grad()
def adapt(
    maps: MapSet,
    seen: NDArray[np.bool_],
    scene: PhotographTarget,
    steps: int,
    *,
    reach: float = 1.0,
    seconds: float | None = None,
    seed: int = 0,
    tell: Callable[[float], None] | None = None,
) -> Adapted:
    """Maps whose levels, contrasts and strengths of relief are the photograph's everywhere.

    Args:
        maps: of the photographed piece, on the plane's grid.
        seen: (H, W) where they are more than a guess.
        scene: the photograph.
        steps: of Adam.
        reach: how far the numbers may be off, beside what is believed of the network's maps.
        seconds: at most, or None.
        seed: of the order of windows.
        tell: called after every step with the share that is done.
    """
    if not steps:
        return Adapted(maps)
    schedule = Schedule(steps, seconds, None)
    scaled = _Scaled(maps, reach)
    size = scene.windows.size
    places_seen = corners(seen, size)
    order = shuffled(scene.windows.count, seed)
    draw = np.random.default_rng(seed)
    adam = Adam([scaled.numbers], _BETAS)
    total, taken = torch.zeros_like(scaled.numbers), 0
    interrupted = False
    try:
        while not schedule.over(math.inf):
            places = torch.tensor([next(order) for _ in range(_PLACES)])
            step = schedule.step
            cuts = [
                scaled(slice(y, y + size), slice(x, x + size))
                for y, x in places_seen[draw.integers(len(places_seen), size=_PLACES)]
            ]
            windows = MapSet.from_stacked(torch.stack([c.stacked() for c in cuts]), maps.texel_size)
            rendered = torch.cat(
                [
                    render_windows(cut.map(lambda m: m[None]), scene, places[i, None], step)
                    for i, cut in enumerate(cuts)
                ]
            )
            loss = compare_windows(rendered, scene, places, half_precision=True)
            loss = loss + price(windows, scene.expected, _PENALTIES, schedule.share)
            (scaled.numbers.grad,) = torch.autograd.grad(loss + scaled.price(), [scaled.numbers])
            if torch.isfinite(scaled.numbers.grad).all():
                adam.step(reach * _RATE * min(1.0, (1.0 - schedule.share) / _HELD))
            if schedule.share >= _HELD:
                total, taken = total + scaled.numbers.detach(), taken + 1
            schedule.step += 1
            if tell is not None:
                tell(min(1.0, schedule.step / steps))
    except KeyboardInterrupt:
        interrupted = True
    with torch.no_grad():
        if taken:
            scaled.numbers.copy_(total / taken)
        return Adapted(scaled(slice(None), slice(None)), interrupted)


class _Scaled:
    """Maps as a function of the numbers they are scaled by."""

    def __init__(self, maps: MapSet, reach: float) -> None:
        stacked = torch.cat([maps.diffuse, maps.specular, maps.roughness])
        self._maps = maps
        self._logits = torch.logit(stacked, eps=_LOGIT_EPSILON)
        self._means = self._logits.mean((1, 2), keepdim=True)
        self._bands = torch.from_numpy(np.stack(split(maps.height[0].numpy())))
        tied = ties(maps.diffuse, self._bands)
        self._features = tied.features
        bands = [_BANDS] * len(self._bands)
        deviations = (*_OFFSETS, *_GAINS, _RELIEF, *bands, *tied.deviations())
        self._deviations = reach * torch.tensor(deviations)
        self.numbers = torch.zeros(len(deviations), requires_grad=True)

    def __call__(self, rows: slice, columns: slice) -> MapSet:
        """Maps of a rectangle."""
        count = len(self._features)
        offsets, gains, relief, bands, *gloss = self.numbers[:, None, None].split(
            [len(_OFFSETS), len(_GAINS), 1, len(self._bands), count, count]
        )
        albedo = len(_OFFSETS) - len(_GAINS) + 1
        gains = torch.cat([gains[:1].expand(albedo, 1, 1), gains[1:]]).exp()
        apart = self._logits[:, rows, columns] - self._means
        tied = [(tie * self._features[:, rows, columns]).sum(0, keepdim=True) for tie in gloss]
        logits = self._means + offsets + gains * apart
        logits = torch.cat([logits[:albedo], logits[albedo:] + torch.cat(tied)])
        diffuse, specular, roughness = torch.sigmoid(logits).split([albedo, 1, 1])
        height = ((relief + bands).exp() * self._bands[:, rows, columns]).sum(0, keepdim=True)
        return replace(
            self._maps, diffuse=diffuse, specular=specular, roughness=roughness, height=height
        )

    def price(self) -> Tensor:
        """What the numbers pay for being off."""
        return _BELIEF * (self.numbers / self._deviations).square().sum()


def corners(seen: NDArray[np.bool_], size: int) -> NDArray[np.int64]:
    """(N, 2) rows and columns where windows that were seen begin; of the best, if none was."""
    total = np.pad(seen.astype(np.float64), ((1, 0), (1, 0))).cumsum(0).cumsum(1)
    windows = total[size:, size:] - total[:-size, size:] - total[size:, :-size]
    windows = (windows + total[:-size, :-size]) / size**2
    least = min(_SEEN, float(np.quantile(windows, 0.75)))
    return np.argwhere(windows >= least)
