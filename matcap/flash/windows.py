"""Windows of a photograph at which renderings are compared with it.

A rendering is lit and viewed as at the place of its window. Comparing place by place separates
relief from albedo: the shading of a bump depends on the direction to the flash, a dark spot does
not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.flash.geometry import plane_points
from matcap.flash.plane import Plane
from matcap.statistics.compare import UNSEEN, Descriptor, Features, describe


@dataclass(frozen=True)
class WindowSettings:
    """Settings of the comparison; docs/notes/prior.md."""

    hiss: float = 2e-3
    """Of the clip level, added to what shot noise grows with: sensors hiss in the dark."""
    together: int = 4
    """Windows described at a time: more outgrow the processor's caches."""
    pairs: int = 64
    """Pairs of windows by which the scatter of statistics is measured."""
    least_scale: float = 0.7
    """Of a target: more than that is no scatter."""
    least_seen: float = 0.3
    """Share of a window's texels that must be inside the picture and not clipped."""


WINDOWS = WindowSettings()


@dataclass(frozen=True)
class Windows:
    """Windows of a photograph: plane points, texture statistics and noise."""

    size: int
    """Of the square windows, in texels."""
    points: Tensor
    """(B, 3, size, size) their plane points."""
    target: Descriptor
    """Their descriptors in the photograph, raised by what an L1 distance falls short of."""
    noise: Tensor | None = None
    """(B, 3, size, size) one more draw of the sensor's noise there, as a share of what shot noise
    deviates by (`shot_deviation`), or None."""
    photographs: Tensor | None = None
    """(B,) which photograph each is of, where there are several (joint.py): 0 is the first one;
    None where there is one."""

    @property
    def count(self) -> int:
        """How many."""
        return len(self.points)


def cut_windows(plane: Plane, bank: Features, size: int, *, most: int | None = None) -> Windows:
    """Windows all over a rectified picture, overlapping by about half.

    Args:
        plane: the picture; windows hardly seen are left out, unless all are.
        bank: features to describe with.
        size: of the windows; not larger than the picture.
        most: so many at most, the first; None for all.
    """
    width, height = plane.size
    places = [(x, y) for y in _steps(height, size) for x in _steps(width, size)]
    seen = [
        (x, y)
        for x, y in places
        if float(plane.valid[y : y + size, x : x + size].float().mean()) >= WINDOWS.least_seen
    ]
    places = (seen or places)[:most]
    cut = torch.stack([plane.linear[:, y : y + size, x : x + size] for x, y in places])
    with torch.no_grad():
        described = [describe(some, plane.encoding, bank) for some in cut.split(WINDOWS.together)]
    points = [
        plane_points(x, y, size, size, (width, height), dtype=torch.float32) for x, y in places
    ]
    noisy = None
    if plane.noise is not None:
        noise = plane.noise / shot_deviation(plane.linear)
        noisy = torch.stack([noise[:, y : y + size, x : x + size] for x, y in places])
    stacked = torch.stack(points)
    target = _raised(Descriptor.joined(described), *side_by_side(stacked, size))
    return Windows(size, stacked, target, noisy)


def side_by_side(points: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Indices of all ordered pairs of windows that lie about a window's width apart.

    They hardly overlap, and have nearly the same light and view.
    """
    centres = points[:, :2].mean(dim=(2, 3))[None].double()
    texel = float(points[0, 0, 0, 1] - points[0, 0, 0, 0])
    distance = torch.cdist(centres, centres)[0] / (texel * size)
    # Places are rounded, and at a border closer.
    first, second = ((distance > 0.85) & (distance < 1.15)).nonzero(as_tuple=True)
    return first, second


def _raised(target: Descriptor, first: Tensor, second: Tensor) -> Descriptor:
    """Scale target statistics to remove the contrast bias of the L1 distance.

    The mean L1 distance between two samples of a scattering statistic is least when one is scaled
    down. The scale is measured on pairs of the photograph's windows and the targets divided by it,
    except autocorrelations, most of which are noise.
    """
    if not len(first):
        return target
    some = torch.randperm(len(first), generator=torch.Generator().manual_seed(0))[: WINDOWS.pairs]

    def raised(level: Tensor) -> Tensor:
        return level / _best_scale(level[first[some]], level[second[some]])

    return replace(
        target,
        grams=tuple(map(raised, target.grams)),
        crosses=tuple(map(raised, target.crosses)),
        quantiles=tuple(map(raised, target.quantiles)),
    )


def _best_scale(sample: Tensor, target: Tensor) -> float:
    """The s in [WINDOWS.least_scale, 1] that minimises the mean of |s sample - target|.

    The median of target / sample, weighted by |sample| over the window's mean |target|.
    """
    size = target.abs().flatten(1).mean(dim=1).clamp_min(UNSEEN)
    weight = (sample.abs().flatten(1) / size[:, None]).flatten()
    quotient = torch.where(sample == 0.0, 0.0, target / sample).flatten()
    ordered, order = quotient.sort()
    heavier = weight[order].double().cumsum(0)
    middle = int(torch.searchsorted(heavier, 0.5 * heavier[-1]))
    return min(1.0, max(WINDOWS.least_scale, float(ordered[min(middle, len(ordered) - 1)])))


def shot_deviation(linear: Tensor) -> Tensor:
    """sqrt(L + hiss), proportional to the standard deviation of shot and read noise."""
    return (linear.clamp_min(0.0) + WINDOWS.hiss).sqrt()


def _steps(length: int, size: int) -> list[int]:
    count = max(1, math.ceil((length - size) / (size / 2)) + 1)
    return [round(i * (length - size) / max(1, count - 1)) for i in range(count)]
