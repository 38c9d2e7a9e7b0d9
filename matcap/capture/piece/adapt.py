"""Adaptation: a piece of the exemplar, put anywhere, must look like the photograph there.

The network gets the drawing right and strengths wrong: how bright, glossy and deep, and by how much
each varies. The paper holds its decoder to the photograph by statistics of renderings at the
photograph's places (4.6). The same holds the exemplar: its windows are lit as if they lay
elsewhere, compared with what is seen there, and a few numbers that scale its maps as a whole are
moved until they agree. So few numbers need few steps, and cannot draw what was not photographed.
Some windows are held back: what was found is taken if it is nearer there. Relief that the
photograph tells outright (strengths.py) hardly moves.

Gloss shows near the highlight alone, and there in statistics more than texel by texel. So among the
numbers is how F0 and roughness go with lightness and with relief: grooves are rougher than ridges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
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
_LEAST_DOUBT = 0.03  # of the logarithm of relief's strength, however well it is told
_HELD_BACK, _FEWEST_HELD = 12, 3  # windows that what is found is judged on
_JUDGING_SEED = 1
_BELIEF = 0.005  # of the distance of statistics, for a number that is off by its deviation
_LOGIT_EPSILON = 1e-4  # of albedo, F0 and roughness: bounds the logit at 0 and 1
_SEEN = 0.95  # share of a window that must have been seen; of the best windows, if none has
# Specks are what was photographed, here.
_PENALTIES = Penalties(outlier=0.0)


@dataclass(frozen=True)
class Adapted:
    """Adapted maps.

    Attributes:
        maps: of the photographed piece; as they were, unless what was found is nearer.
        interrupted: ended by Ctrl-C, with the numbers so far.
        change: what was tried, and whether it is in the maps; None if nothing was.
    """

    maps: MapSet
    interrupted: bool = False
    change: Change | None = None


@dataclass(frozen=True)
class Change:
    """What adaptation came to.

    Attributes:
        before, after: mean distance of statistics on windows that were held back from it.
        kept: whether it is nearer after, and so taken.
        relief: factor of all relief together.
        albedo: mean change of the logit of albedo's channels.
        specular, roughness: change of their logits.
    """

    before: float
    after: float
    kept: bool
    relief: float
    albedo: float
    specular: float
    roughness: float


@torch.enable_grad()
def adapt(
    maps: MapSet,
    seen: NDArray[np.bool_],
    scene: PhotographTarget,
    steps: int,
    *,
    reach: float = 1.0,
    doubt: Sequence[float] = (),
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
        doubt: deviations of the logarithm of relief's strength, band by band as BANDS are, where
            it is told otherwise; relief stands where it is told well.
        seconds: at most, or None.
        seed: of the order of windows.
        tell: called after every step with the share that is done.
    """
    if not steps:
        return Adapted(maps)
    schedule = Schedule(steps, seconds, None)
    scaled = _Scaled(maps, reach, doubt)
    size = scene.windows.size
    places_seen = corners(seen, size)
    fitted, held = _parted(scene.windows.count, seed)
    order = shuffled(len(fitted), seed)
    draw = np.random.default_rng(seed)
    adam = Adam([scaled.numbers], _BETAS)
    total, taken = torch.zeros_like(scaled.numbers), 0
    interrupted = False
    try:
        while not schedule.over(math.inf):
            places = fitted[[next(order) for _ in range(_PLACES)]]
            step = schedule.step
            cuts = _cut(scaled, places_seen, draw, _PLACES, size)
            windows = MapSet.from_stacked(torch.stack([c.stacked() for c in cuts]), maps.texel_size)
            loss = _distance(cuts, scene, places, step)
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
        change = _judged(scaled, scene, held, places_seen)
        whole = scaled(slice(None), slice(None)) if change.kept else maps
        return Adapted(whole, interrupted, change)


def _parted(count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Numbers of windows that are fitted to, and of those held back; the same ones if few."""
    mixed = torch.randperm(count, generator=torch.Generator().manual_seed(seed))
    held = min(_HELD_BACK, count // 3)
    return (mixed[held:], mixed[:held]) if held >= _FEWEST_HELD else (mixed, mixed)


def _cut(
    scaled: _Scaled,
    corners_seen: NDArray[np.int64],
    draw: np.random.Generator,
    count: int,
    size: int,
) -> list[MapSet]:
    """Windows of the maps, anywhere they were seen."""
    return [
        scaled(slice(y, y + size), slice(x, x + size))
        for y, x in corners_seen[draw.integers(len(corners_seen), size=count)]
    ]


def _distance(cuts: list[MapSet], scene: PhotographTarget, places: Tensor, step: int) -> Tensor:
    """Mean distance of windows of maps, put at places, from what is seen there."""
    rendered = [
        render_windows(cut.map(lambda m: m[None]), scene, places[i, None], step)
        for i, cut in enumerate(cuts)
    ]
    return compare_windows(torch.cat(rendered), scene, places, half_precision=True)


def _judged(
    scaled: _Scaled, scene: PhotographTarget, held: Tensor, corners_seen: NDArray[np.int64]
) -> Change:
    """What numbers change on windows that they were not fitted to."""
    found = scaled.numbers.clone()

    def distance() -> float:
        draw = np.random.default_rng(_JUDGING_SEED)  # the same places, whatever the numbers
        parts = []
        for places in held.split(_PLACES):
            cuts = _cut(scaled, corners_seen, draw, len(places), scene.windows.size)
            parts.append(float(_distance(cuts, scene, places, 0)) * len(places))
        return sum(parts) / len(held)

    after = distance()
    scaled.numbers.zero_()
    before = distance()
    scaled.numbers.copy_(found)
    numbers = found.tolist()
    return Change(
        before=before,
        after=after,
        kept=after < before,
        relief=math.exp(numbers[len(_OFFSETS) + len(_GAINS)]),
        albedo=sum(numbers[:3]) / 3.0,
        specular=numbers[3],
        roughness=numbers[4],
    )


class _Scaled:
    """Maps as a function of the numbers they are scaled by."""

    def __init__(self, maps: MapSet, reach: float, doubt: Sequence[float] = ()) -> None:
        stacked = torch.cat([maps.diffuse, maps.specular, maps.roughness])
        self._maps = maps
        self._logits = torch.logit(stacked, eps=_LOGIT_EPSILON)
        self._means = self._logits.mean((1, 2), keepdim=True)
        self._bands = torch.from_numpy(np.stack(split(maps.height[0].numpy())))
        tied = ties(maps.diffuse, self._bands)
        self._features = tied.features
        bands = [_BANDS] * len(self._bands)
        bands[: len(doubt)] = [min(_BANDS, max(one, _LEAST_DOUBT)) for one in doubt]
        relief = min(_RELIEF, max(min(doubt), _LEAST_DOUBT)) if doubt else _RELIEF
        deviations = (*_OFFSETS, *_GAINS, relief, *bands, *tied.deviations())
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
