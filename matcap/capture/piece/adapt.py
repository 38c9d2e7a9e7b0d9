"""Texture-statistics fit: windows of the exemplar, lit anywhere, must match the photograph there.

The network's structure is right and its amplitudes are off: mean and contrast of albedo, and the
strength of relief. The paper holds its decoder to the photograph by statistics of renderings at the
photograph's places (4.6). The same holds the exemplar: its windows are lit as if they lay
elsewhere, compared with what is seen there, and a few numbers that scale its maps as a whole are
moved until they agree. So few numbers need few steps, and cannot draw what was not photographed.
Some windows are a validation set: the result is kept if it is nearer there. Relief that the
photograph measures (strengths.py) hardly moves.
F0 and roughness are the classes' (levels.py) and stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.piece.smooth import smoothed, split
from matcap.capture.piece.tuned import ADAPT
from matcap.flash.adam import Adam
from matcap.flash.likeness import PhotographTarget, compare_windows, render_windows, shuffled
from matcap.flash.penalty import price
from matcap.flash.schedule import Schedule

Floats = NDArray[np.float32]


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
    """

    before: float
    after: float
    kept: bool
    relief: float
    albedo: float


@dataclass(frozen=True)
class Leg:
    """A leg of adaptation.

    Attributes:
        steps: of Adam.
        reach: factor on the prior deviations of the scaling parameters.
        doubt: standard deviations of the log strength of relief, of each of BANDS, where the
            photograph measures it.
        seconds: at most, or infinity.
        seed: of the order of windows.
        on_progress: called after every step with the share that is done.
    """

    steps: int
    reach: float = 1.0
    doubt: Sequence[float] = ()
    seconds: float = math.inf
    seed: int = 0
    on_progress: Callable[[float], None] = lambda _share: None


@torch.enable_grad()
def adapt(maps: MapSet, seen: NDArray[np.bool_], scene: PhotographTarget, leg: Leg) -> Adapted:
    """Maps whose levels, contrasts and strengths of relief are the photograph's everywhere.

    Args:
        maps: of the photographed piece, on the plane's grid.
        seen: (H, W) where they are more than a guess.
        scene: the photograph.
        leg: how far.
    """
    if not leg.steps:
        return Adapted(maps)
    scaled = _ScaledMaps(maps, leg.reach, leg.doubt)
    seen_corners = corners(seen, scene.windows.size)
    fitted, validation = _parted(scene.windows.count, leg.seed)
    interrupted = _Fit(scaled, scene, seen_corners, fitted).run(leg)
    with torch.no_grad():
        change = _judged(scaled, scene, validation, seen_corners)
        return Adapted(scaled.maps() if change.kept else maps, interrupted, change)


@dataclass(frozen=True)
class _Fit:
    """Adam on the numbers that maps are scaled by.

    Attributes:
        scaled: maps and numbers; changed in place.
        scene: the photograph.
        corners: where windows of the maps begin.
        fitted: windows of the photograph that are looked at.
    """

    scaled: _ScaledMaps
    scene: PhotographTarget
    corners: NDArray[np.int64]
    fitted: Tensor

    def run(self, leg: Leg) -> bool:
        """Fit; whether Ctrl-C ended it. The numbers are the mean of those at the end."""
        numbers, schedule = self.scaled.numbers, Schedule(leg.steps, leg.seconds, None)
        order, draw = shuffled(len(self.fitted), leg.seed), np.random.default_rng(leg.seed)
        adam = Adam([numbers], ADAPT.betas)
        total, averaged = torch.zeros_like(numbers), 0
        interrupted = False
        try:
            while not schedule.over(math.inf):
                places = self.fitted[[next(order) for _ in range(ADAPT.windows)]]
                (numbers.grad,) = torch.autograd.grad(self._loss(places, draw, schedule), [numbers])
                if torch.isfinite(numbers.grad).all():
                    falling = min(1.0, (1.0 - schedule.share) / ADAPT.averaged_from)
                    adam.step(leg.reach * ADAPT.rate * falling)
                if schedule.share >= ADAPT.averaged_from:
                    total, averaged = total + numbers.detach(), averaged + 1
                schedule.step += 1
                leg.on_progress(min(1.0, schedule.step / leg.steps))
        except KeyboardInterrupt:
            interrupted = True
        if averaged:
            with torch.no_grad():
                numbers.copy_(total / averaged)
        return interrupted

    def _loss(self, places: Tensor, draw: np.random.Generator, schedule: Schedule) -> Tensor:
        cuts = _cut(self.scaled, self.corners, draw, len(places), self.scene.windows.size)
        stacked = torch.stack([cut.stacked() for cut in cuts])
        windows = MapSet.from_stacked(stacked, cuts[0].texel_size)
        distance = _distance(cuts, self.scene, places, schedule.step)
        paid = price(windows, self.scene.expected, ADAPT.penalties, schedule.share)
        return distance + paid + self.scaled.price()


def _parted(count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Indices of windows to fit and to validate on; the same ones if few."""
    mixed = torch.randperm(count, generator=torch.Generator().manual_seed(seed))
    validation = min(ADAPT.validation, count // 3)
    return (
        (mixed[validation:], mixed[:validation])
        if validation >= ADAPT.least_validation
        else (mixed, mixed)
    )


def _cut(
    scaled: _ScaledMaps,
    corners_seen: NDArray[np.int64],
    draw: np.random.Generator,
    count: int,
    size: int,
) -> list[MapSet]:
    """Windows of the maps, anywhere they were seen."""
    return [
        scaled.maps(slice(y, y + size), slice(x, x + size))
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
    scaled: _ScaledMaps,
    scene: PhotographTarget,
    validation: Tensor,
    corners_seen: NDArray[np.int64],
) -> Change:
    """The change of the distance on validation windows."""
    numbers = scaled.numbers.clone()

    def distance() -> float:
        draw = np.random.default_rng(ADAPT.judging_seed)  # the same places, whatever the numbers
        parts = []
        for places in validation.split(ADAPT.windows):
            cuts = _cut(scaled, corners_seen, draw, len(places), scene.windows.size)
            parts.append(float(_distance(cuts, scene, places, 0)) * len(places))
        return sum(parts) / len(validation)

    after = distance()
    scaled.numbers.zero_()
    before = distance()
    scaled.numbers.copy_(numbers)
    scaling = scaled.scaling(numbers)
    return Change(
        before=before,
        after=after,
        kept=after < before,
        relief=math.exp(float(scaling.relief)),
        albedo=sum(scaling.offset.tolist()) / 3.0,
    )


@dataclass(frozen=True)
class Scaling:
    """What maps are scaled by, (N,) each; zeros leave them as they are.

    Attributes:
        offset: (3,) added to the logits of albedo.
        gain: logarithm of the factor on how far they are from their mean.
        relief: logarithm of the factor on heights.
        bands: likewise on each band beside.
    """

    offset: Tensor
    gain: Tensor
    relief: Tensor
    bands: Tensor

    def vector(self) -> Tensor:
        """All of them, one after the other."""
        return torch.cat([getattr(self, f.name) for f in fields(self)])

    @staticmethod
    def of(vector: Tensor, bands: int) -> Scaling:
        """The inverse of vector() for so many bands."""
        return Scaling(*vector.split([3, 1, 1, bands]))


class _ScaledMaps:
    """Maps as a function of the numbers they are scaled by."""

    def __init__(self, maps: MapSet, reach: float, doubt: Sequence[float] = ()) -> None:
        self._maps = maps
        self._logits = torch.logit(maps.diffuse, eps=ADAPT.logit_epsilon)
        self._means = self._logits.mean((1, 2), keepdim=True)
        self._bands = torch.from_numpy(np.stack(split(maps.height[0].numpy())))
        self._deviations = reach * self._prior_deviations(doubt).vector()
        self.numbers = torch.zeros(len(self._deviations), requires_grad=True)

    def _prior_deviations(self, doubt: Sequence[float]) -> Scaling:
        """Prior standard deviation of each scaling parameter; of relief, band by band."""
        bands = torch.full((len(self._bands),), ADAPT.band)
        for index, each in enumerate(doubt):
            bands[index] = min(ADAPT.band, max(each, ADAPT.least_doubt))
        relief = max(min(doubt), ADAPT.least_doubt) if doubt else ADAPT.relief
        return Scaling(
            offset=torch.full((3,), ADAPT.offset_albedo),
            gain=torch.tensor([ADAPT.gain_albedo]),
            relief=torch.tensor([min(ADAPT.relief, relief)]),
            bands=bands,
        )

    def scaling(self, numbers: Tensor) -> Scaling:
        """Numbers by name."""
        return Scaling.of(numbers, len(self._bands))

    def maps(self, rows: slice = slice(None), columns: slice = slice(None)) -> MapSet:
        """Maps of a rectangle."""
        by = self.scaling(self.numbers)
        deviation = self._logits[:, rows, columns] - self._means
        albedo = torch.sigmoid(self._means + by.offset[:, None, None] + by.gain.exp() * deviation)
        heights = (by.relief + by.bands).exp()[:, None, None] * self._bands[:, rows, columns]
        return replace(
            self._maps,
            diffuse=albedo,
            specular=self._maps.specular[:, rows, columns],
            roughness=self._maps.roughness[:, rows, columns],
            height=heights.sum(0, keepdim=True),
        )

    def price(self) -> Tensor:
        """Negative log prior of the scaling parameters: sum of (x / deviation)^2, weighted."""
        return ADAPT.belief * (self.numbers / self._deviations).square().sum()


def corners(seen: NDArray[np.bool_], size: int) -> NDArray[np.int64]:
    """(N, 2) rows and columns where windows that were seen begin; of the best, if none was."""
    total = np.pad(seen.astype(np.float64), ((1, 0), (1, 0))).cumsum(0).cumsum(1)
    windows = total[size:, size:] - total[:-size, size:] - total[size:, :-size]
    windows = (windows + total[:-size, :-size]) / size**2
    least = min(ADAPT.seen, float(np.quantile(windows, 0.75)))
    return np.argwhere(windows >= least)


def even_contrast(albedo: Floats, weight: Floats) -> Floats:
    """Log albedo (3, H, W) whose bands vary as much everywhere as where they are seen.

    A stationary sample has the same contrast everywhere; under a highlight albedo hardly shows, and
    the network's answer fades.

    Args:
        albedo: as the network gives it.
        weight: (H, W) how far it is seen, in [0, 1].
    """
    local = weight + np.float32(ADAPT.contrast_unseen)
    under = smoothed(local, ADAPT.contrast_around)
    grey = split(albedo.mean(0))
    channels = [split(channel) for channel in albedo]
    even = np.stack([bands[-1] for bands in channels])
    for index, band in enumerate(grey[:-1]):
        squared = np.square(band)
        wanted = np.sqrt((squared * weight).sum() / max(float(weight.sum()), 1e-9))
        here = np.sqrt(smoothed(squared * local, ADAPT.contrast_around) / under)
        gain = wanted / np.maximum(here, ADAPT.contrast_faintest)
        gain = gain.clip(ADAPT.contrast_least, ADAPT.contrast_most)
        even += gain * np.stack([bands[index] for bands in channels])
    return even
