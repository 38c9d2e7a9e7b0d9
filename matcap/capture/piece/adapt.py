"""Texture-statistics fit: windows of the exemplar, rendered anywhere, must match the photograph.

The network predicts structure well, but biased amplitudes: mean and contrast of albedo, and
amplitude of relief. These few scaling parameters are fitted by Adam. The loss is that of
[henzler2021, sec. 4.6]: windows of the maps, rendered at other places under the light there, are
compared with the photograph's windows at those places by texture statistics; plus a Gaussian prior,
narrow for relief that the photograph measures (strengths.py). The result is kept if it lowers the
distance on validation windows. F0 and roughness, fitted to the classes (levels.py), are fixed.
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
    """Result of a stage.

    Attributes:
        maps: the scaled maps if kept, else the given ones.
        interrupted: ended by Ctrl-C, with the parameters so far.
        change: what was fitted, kept or not; None without steps.
    """

    maps: MapSet
    interrupted: bool = False
    change: Change | None = None


@dataclass(frozen=True)
class Change:
    """Fitted scaling, and its effect.

    Attributes:
        before, after: mean distance of texture statistics on the validation windows.
        kept: whether the distance fell, and the result was taken.
        relief: factor on height, all bands.
        albedo: change of the logit of albedo, mean over channels.
    """

    before: float
    after: float
    kept: bool
    relief: float
    albedo: float


@dataclass(frozen=True)
class FitStage:
    """Settings of one stage of the texture-statistics fit.

    Attributes:
        steps: of Adam.
        reach: factor on the prior standard deviations of the scaling parameters.
        deviation: standard deviation of the measured log relief energy in each of BANDS; empty
            without a measurement.
        seconds: time limit, may be infinite.
        seed: of the order of windows.
        on_progress: called after every step with the completed share, in [0, 1].
    """

    steps: int
    reach: float = 1.0
    deviation: Sequence[float] = ()
    seconds: float = math.inf
    seed: int = 0
    on_progress: Callable[[float], None] = lambda _share: None


@torch.enable_grad()
def adapt(
    maps: MapSet, seen: NDArray[np.bool_], scene: PhotographTarget, fit_stage: FitStage
) -> Adapted:
    """Fit offset and contrast of albedo, and amplitudes of relief, to a photograph's statistics.

    Args:
        maps: of the exemplar, on the plane's grid.
        seen: (H, W) bool, valid texels of the photograph.
        scene: the photograph's windows and statistics.
        fit_stage: settings of the stage.
    """
    if not fit_stage.steps:
        return Adapted(maps)
    scaled = _ScaledMaps(maps, fit_stage.reach, fit_stage.deviation)
    seen_corners = corners(seen, scene.windows.size)
    fitted, validation = _parted(scene.windows.count, fit_stage.seed)
    interrupted = _Fit(scaled, scene, seen_corners, fitted).run(fit_stage)
    with torch.no_grad():
        change = _judged(scaled, scene, validation, seen_corners)
        return Adapted(scaled.maps() if change.kept else maps, interrupted, change)


@dataclass(frozen=True)
class _Fit:
    """Adam on the scaling parameters.

    Attributes:
        scaled: maps and parameters; changed in place.
        scene: the photograph's windows and statistics.
        corners: (N, 2) row and column of the windows of the maps.
        fitted: indices of the photograph's windows to fit.
    """

    scaled: _ScaledMaps
    scene: PhotographTarget
    corners: NDArray[np.int64]
    fitted: Tensor

    def run(self, fit_stage: FitStage) -> bool:
        """Fit; average parameters over the last steps. Returns whether Ctrl-C ended it."""
        numbers, schedule = self.scaled.numbers, Schedule(fit_stage.steps, fit_stage.seconds, None)
        order, draw = (
            shuffled(len(self.fitted), fit_stage.seed),
            np.random.default_rng(fit_stage.seed),
        )
        adam = Adam([numbers], ADAPT.betas)
        total, averaged = torch.zeros_like(numbers), 0
        interrupted = False
        try:
            while not schedule.over(math.inf):
                places = self.fitted[[next(order) for _ in range(ADAPT.windows)]]
                (numbers.grad,) = torch.autograd.grad(self._loss(places, draw, schedule), [numbers])
                if torch.isfinite(numbers.grad).all():
                    falling = min(1.0, (1.0 - schedule.share) / ADAPT.averaged_from)
                    adam.step(fit_stage.reach * ADAPT.rate * falling)
                if schedule.share >= ADAPT.averaged_from:
                    total, averaged = total + numbers.detach(), averaged + 1
                schedule.step += 1
                fit_stage.on_progress(min(1.0, schedule.step / fit_stage.steps))
        except KeyboardInterrupt:
            interrupted = True
        if averaged:
            with torch.no_grad():
                numbers.copy_(total / averaged)
        return interrupted

    def _loss(self, places: Tensor, draw: np.random.Generator, schedule: Schedule) -> Tensor:
        """Texture distance + penalties + negative log prior, for the photograph's `places`."""
        cuts = _cut(self.scaled, self.corners, draw, len(places), self.scene.windows.size)
        stacked = torch.stack([cut.stacked() for cut in cuts])
        windows = MapSet.from_stacked(stacked, cuts[0].texel_size)
        distance = _distance(cuts, self.scene, places, schedule.step)
        paid = price(windows, self.scene.expected, ADAPT.penalties, schedule.share)
        return distance + paid + self.scaled.price()


def _parted(count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Indices of windows to fit, and of windows to validate on; both all of them if few."""
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
    """`count` random windows of the maps, `size` texels a side, at the given corners."""
    return [
        scaled.maps(slice(y, y + size), slice(x, x + size))
        for y, x in corners_seen[draw.integers(len(corners_seen), size=count)]
    ]


def _distance(cuts: list[MapSet], scene: PhotographTarget, places: Tensor, step: int) -> Tensor:
    """Mean statistics distance of map windows, rendered at `places`, to the photograph's."""
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
    """The texture distance on validation windows before and after scaling."""
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
    """Scaling parameters of maps, (N,) each; zeros are the identity.

    Attributes:
        offset: (3,) added to the logits of albedo.
        gain: log factor on the logits' deviation from their mean.
        relief: log factor on height, all bands.
        bands: further log factor on each of BANDS.
    """

    offset: Tensor
    gain: Tensor
    relief: Tensor
    bands: Tensor

    def vector(self) -> Tensor:
        """All parameters concatenated."""
        return torch.cat([getattr(self, f.name) for f in fields(self)])

    @staticmethod
    def of(vector: Tensor, bands: int) -> Scaling:
        """The inverse of vector(), for a number of bands."""
        return Scaling(*vector.split([3, 1, 1, bands]))


class _ScaledMaps:
    """Maps as a differentiable function of their scaling parameters, the tensor `numbers`."""

    def __init__(self, maps: MapSet, reach: float, deviation: Sequence[float] = ()) -> None:
        self._maps = maps
        self._logits = torch.logit(maps.diffuse, eps=ADAPT.logit_epsilon)
        self._means = self._logits.mean((1, 2), keepdim=True)
        self._bands = torch.from_numpy(np.stack(split(maps.height[0].numpy())))
        self._deviations = reach * self._prior_deviations(deviation).vector()
        self.numbers = torch.zeros(len(self._deviations), requires_grad=True)

    def _prior_deviations(self, deviation: Sequence[float]) -> Scaling:
        """Prior standard deviation of each scaling parameter; of relief, band by band."""
        bands = torch.full((len(self._bands),), ADAPT.band)
        for index, each in enumerate(deviation):
            bands[index] = min(ADAPT.band, max(each, ADAPT.least_deviation))
        relief = max(min(deviation), ADAPT.least_deviation) if deviation else ADAPT.relief
        return Scaling(
            offset=torch.full((3,), ADAPT.offset_albedo),
            gain=torch.tensor([ADAPT.gain_albedo]),
            relief=torch.tensor([min(ADAPT.relief, relief)]),
            bands=bands,
        )

    def scaling(self, numbers: Tensor) -> Scaling:
        """The parameter vector by name."""
        return Scaling.of(numbers, len(self._bands))

    def maps(self, rows: slice = slice(None), columns: slice = slice(None)) -> MapSet:
        """Scaled maps of a rectangle of rows and columns."""
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
    """(N, 2) first row and column of windows of `size` texels a side with enough visible texels.

    These are at least the quarter of windows with the most.
    """
    total = np.pad(seen.astype(np.float64), ((1, 0), (1, 0))).cumsum(0).cumsum(1)
    windows = total[size:, size:] - total[:-size, size:] - total[size:, :-size]
    windows = (windows + total[:-size, :-size]) / size**2
    least = min(ADAPT.seen, float(np.quantile(windows, 0.75)))
    return np.argwhere(windows >= least)


def even_contrast(albedo: Floats, weight: Floats) -> Floats:
    """Local contrast normalisation of log albedo (3, H, W), band by band.

    The local contrast becomes its mean over visible texels: a stationary sample has equal contrast
    everywhere, but the network's prediction loses it under a highlight.

    Args:
        albedo: predicted log albedo.
        weight: (H, W) visibility, in [0, 1].
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
