"""Windows of photographs at which renderings are compared, and texture distances over them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.field.field import computes_bfloat16
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import render_flash
from matcap.flash.rectify import Plane
from matcap.space.freeze import Drawing
from matcap.statistics.compare import (
    UNSEEN,
    Descriptor,
    Encoding,
    Features,
    Weights,
    describe,
    distance,
)
from matcap.statistics.lattice import Wave

# Windows of a photograph at which renderings are compared with it.
#
# A rendering is lit and viewed as at the place of its window. Comparing place by place separates
# relief from albedo: the shading of a bump depends on the direction to the flash, a dark spot does
# not.

# Windows in which photograph and rendering are compared; docs/notes/prior.md.
_HISS = 2e-3  # read noise, as a share of the clip level added to the radiance in shot noise
_TOGETHER = 4  # windows described at a time, so that they fit the processor's caches
_PAIRS = 64  # pairs of windows on which the bias of the L1 distance is measured
_LEAST_SCALE = 0.7  # lower limit of the correcting scale
_LEAST_SEEN = 0.3  # least valid share of a window


@dataclass(frozen=True)
class Windows:
    """Windows of a photograph: plane points, texture statistics and noise."""

    size: int
    """Side of the square windows, texels."""
    points: Tensor
    """(B, 3, size, size) plane points."""
    target: Descriptor
    """Descriptors of the photograph's windows, corrected for the bias of the L1 distance."""
    noise: Tensor | None = None
    """(B, 3, size, size) a sample of the sensor noise over `shot_deviation`, or None."""

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.points)


def cut_windows(plane: Plane, bank: Features, size: int, *, most: int | None = None) -> Windows:
    """Cut windows from a rectified picture, overlapping by about half, and describe them.

    Args:
        plane: the picture; windows with too few valid texels are omitted, unless all are.
        bank: features of the descriptors.
        size: side of the windows, texels, at most the picture's.
        most: largest number of windows, spread over the picture; None for all.
    """
    width, height = plane.size
    places = [(x, y) for y in _steps(height, size) for x in _steps(width, size)]
    seen = [
        (x, y)
        for x, y in places
        if float(plane.valid[y : y + size, x : x + size].float().mean()) >= _LEAST_SEEN
    ]
    places = seen or places
    places = places[:: -(-len(places) // most)] if most else places
    cut = torch.stack([plane.linear[:, y : y + size, x : x + size] for x, y in places])
    with torch.no_grad():
        described = [describe(some, plane.encoding, bank) for some in cut.split(_TOGETHER)]
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
    # Positions are rounded, and closer at a border.
    first, second = ((distance > 0.85) & (distance < 1.15)).nonzero(as_tuple=True)
    return first, second


def self_difference(windows: Windows, weights: Weights) -> float:
    """Mean distance between adjacent windows of a photograph, without their mean colour.

    At an error of 1 self-difference a rendering differs from the photograph as much as the
    photograph's parts do from each other. The mean colour depends on the light. NaN if no two
    windows are adjacent.

    Args:
        windows: of one photograph.
    """
    first, second = side_by_side(windows.points, windows.size)
    if not len(first):
        return math.nan
    target = windows.target
    pairs = target.select(first), target.select(second)
    return float(distance(*pairs, replace(weights, mean=0.0)).mean())


def _raised(target: Descriptor, first: Tensor, second: Tensor) -> Descriptor:
    """Scale target statistics to remove the contrast bias of the L1 distance.

    The mean L1 distance between two samples of a scattering statistic is least when one is scaled
    down. The scale is measured on pairs of the photograph's windows and the targets divided by it,
    except autocorrelations, most of which are noise.
    """
    if not len(first):
        return target
    some = torch.randperm(len(first), generator=torch.Generator().manual_seed(0))[:_PAIRS]

    def raised(level: Tensor) -> Tensor:
        return level / _best_scale(level[first[some]], level[second[some]])

    return replace(
        target,
        grams=tuple(map(raised, target.grams)),
        crosses=tuple(map(raised, target.crosses)),
        quantiles=tuple(map(raised, target.quantiles)),
    )


def _best_scale(sample: Tensor, target: Tensor) -> float:
    """The s in [_LEAST_SCALE, 1] that minimises the mean of |s sample - target|.

    The median of target / sample, weighted by |sample| over the window's mean |target|.
    """
    size = target.abs().flatten(1).mean(dim=1).clamp_min(UNSEEN)
    weight = (sample.abs().flatten(1) / size[:, None]).flatten()
    quotient = torch.where(sample == 0.0, 0.0, target / sample).flatten()
    ordered, order = quotient.sort()
    heavier = weight[order].double().cumsum(0)
    middle = int(torch.searchsorted(heavier, 0.5 * heavier[-1]))
    return min(1.0, max(_LEAST_SCALE, float(ordered[min(middle, len(ordered) - 1)])))


def shot_deviation(linear: Tensor) -> Tensor:
    """sqrt(L + hiss), proportional to the standard deviation of shot and read noise."""
    return (linear.clamp_min(0.0) + _HISS).sqrt()


def _steps(length: int, size: int) -> list[int]:
    """First texels of windows of a size that cover a length, overlapping by at least half."""
    count = max(1, math.ceil((length - size) / (size / 2)) + 1)
    return [round(i * (length - size) / max(1, count - 1)) for i in range(count)]


# Texture distance of a material to a photograph: windows rendered under its light.
#
# The loss of a decoder [henzler2021, sec. 4.3 and 4.6].


@dataclass(frozen=True)
class PhotographTarget:
    """Target statistics of windows of a photograph."""

    windows: Windows
    """Windows, with their statistics."""
    setup: FlashSetup
    """Camera and flash."""
    encoding: Encoding
    """Colour space of the comparison."""
    bank: Features
    """Features whose statistics are compared."""
    waves: tuple[Wave, ...]
    """Frequency vectors of the photograph's lattice, cycles per texel."""
    texel_size: float
    """Side of a texel, plane units."""
    weights: Weights = Weights()
    """Weights of the statistics."""
    expected: Tensor | None = None
    """(5,) logits of the coarse fit's diffuse albedo, F0 and roughness, or None."""
    drawing: Drawing | None = None
    """The drawing that the decoder reads, or None."""


def shuffled(count: int, seed: int) -> Iterator[int]:
    """Yield random permutations of 0 ... count - 1, without end."""
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield from torch.randperm(count, generator=generator).tolist()


def render_windows(maps: MapSet, target: PhotographTarget, places: Tensor, step: int) -> Tensor:
    """(B, 3, size, size) radiance of maps, lit and viewed as at `places`, with sensor noise."""
    windows = target.windows
    rendered = render_flash(maps, target.setup, windows.points[places])
    return rendered if windows.noise is None else with_noise(rendered, windows.noise[places], step)


def compare_windows(
    rendered: Tensor, target: PhotographTarget, places: Tensor, *, half_precision: bool
) -> Tensor:
    """Mean texture distance of renderings to the photograph's windows at `places`; a scalar."""
    with torch.autocast("cpu", torch.bfloat16, enabled=half_precision and computes_bfloat16()):
        described = describe(rendered, target.encoding, target.bank)
    return distance(described, target.windows.target.select(places), target.weights).mean()


def with_noise(rendered: Tensor, noise: Tensor, step: int) -> Tensor:
    """Add sensor noise (Windows.noise) to renderings (B, 3, size, size).

    The noise is shifted and signed at random by step, and scaled by shot_deviation.
    """
    generator = torch.Generator().manual_seed(step)
    down, across, sign = torch.randint(noise.shape[-1], (3,), generator=generator).tolist()
    moved = noise.roll((down, across), dims=(-2, -1)) * (1.0 if sign % 2 else -1.0)
    return rendered + moved * shot_deviation(rendered.detach())
