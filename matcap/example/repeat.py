"""A seamless tile of the exemplar itself: flattened, cut along minimum-cost seams, blended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.errors import UsageError
from matcap.example.blend import ArraySource
from matcap.example.candidates import UNIT, choose_scale, planes_of_maps
from matcap.example.exemplar import COLOURED, DIFFUSE, HEIGHT, ROUGHNESS, SPECULAR, Floats
from matcap.example.lattice import Frequency, PhasedLattice
from matcap.example.straighten import (
    LENGTH,
    STRETCH,
    Planes,
    Shift,
    best_shift,
    copies,
    least_cut,
    sheared,
    unbent,
)
from matcap.field.plane import Grid, Period, Rectangle

# Removes low frequencies of albedo, F0 and roughness, which make a tiling look periodic.

# The seamless tile; docs/notes/field.md.

# Parts a side whose medians low frequencies are fitted to. Fewer are less affected by stains,
# and resolve low frequencies less.
_CELLS = 16
# Half periods a side up to which frequencies are removed. More make repeats less visible, and
# remove more of a large pattern.
_SLOW = 4
# F0 of the brightest channel above which a texel is metal, where F0 has a colour. Gems have up
# to 0.17, metals 0.4 and more.
_METAL = 0.25

_BLACK = 1e-3  # lower limit of albedo and F0 in logarithms
_ORDERS = np.arange(_SLOW + 1)


def flatten(maps: Floats) -> Floats:
    """Stacked maps (6 or 8, H, W) without their low frequencies.

    Low frequencies are cosines of up to _SLOW half periods a side, fitted to the medians of
    _CELLS^2 parts; medians, so that a stain has little effect. Albedo and F0 are divided by
    them, roughness is reduced by them; means are kept. Where F0 has a colour, the median of metal,
    or of dielectric, is subtracted first, so that a part with more rust than metal does not count
    as darker.
    """
    flattened = maps.copy()
    metal = maps[SPECULAR].max(axis=0) > _METAL
    classes = (metal, ~metal) if len(maps[SPECULAR]) == COLOURED else ()
    # All maps but the height, whose mean slope repeat.py removes.
    roughness = len(maps) - 2
    for index in range(roughness + 1):
        if index < roughness:
            logs = np.log(np.maximum(maps[index], _BLACK))
            flattened[index] *= np.exp(-_slow(_less_class_medians(logs, classes)))
        else:
            flattened[index] -= _slow(_less_class_medians(maps[index], classes))
    np.clip(flattened[:-1], 0.0, 1.0, out=flattened[:-1])
    return flattened


def _less_class_medians(plane: Floats, classes: tuple[NDArray[np.bool_], ...]) -> Floats:
    """(H, W) plane less the median of each texel's material class, given as masks."""
    residual = plane.copy()
    for mask in classes:
        if mask.any():
            residual[mask] -= np.median(plane[mask])
    return residual


def _slow(plane: Floats) -> Floats:
    """(H, W) low frequencies of a plane, of zero mean."""
    split = (np.array_split(np.arange(side), _CELLS) for side in plane.shape)
    parts = [[part for part in some if part.size] for some in split]
    rows, columns = parts
    medians = np.array(
        [[np.median(plane[r[0] : r[-1] + 1, c[0] : c[-1] + 1]) for c in columns] for r in rows]
    )
    sided = zip(parts, plane.shape, strict=True)
    middles = [[(part.mean() + 0.5) / side for part in some] for some, side in sided]
    down, across = (_waves(np.array(some)) for some in middles)
    amounts = np.linalg.pinv(down) @ medians @ np.linalg.pinv(across).T
    ends = [_waves((np.arange(side) + 0.5) / side) for side in plane.shape]
    amounts[_ORDERS[:, None] + _ORDERS[None, :] > _SLOW] = 0.0
    slow = ends[0] @ amounts @ ends[1].T
    return (slow - slow.mean()).astype(np.float32)


def _waves(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, orders) cosines of 0, 1, ... half periods a side, at positions in [0, 1]."""
    return np.cos(np.pi * places[:, None] * _ORDERS[None, :])


# Maps of a seamless tile by gradient-domain blending: a Poisson equation on a torus.

_BLUR = 6.0  # texels over which the step at a seam is spread. Less shows the seam, more a halo.

TileTexels = NDArray[np.int64]


def joined(maps: Floats, x: TileTexels, y: TileTexels) -> Floats:
    """(6 or 8, h, w) seamless stacked maps.

    Height minimises sum |grad h - g|^2 on the torus, g the exemplar's differences between texels;
    this removes its mean slope. The other maps minimise the same plus sum (m - shown)^2 / blur^2,
    which spreads the step at a seam over about _BLUR texels.

    Args:
        maps: stacked, of the exemplar.
        x, y: (h, w) texels of the exemplar that the tile shows.
    """
    planes = np.stack([_closed(plane, x, y, _BLUR) for plane in maps[:-1]])
    np.clip(planes, 0.0, 1.0, out=planes)
    return np.concatenate([planes, _closed(maps[-1], x, y, None)[None]])


def is_cut(x: TileTexels, y: TileTexels) -> NDArray[np.bool_]:
    """(h, w) whether a seam lies between a texel and the one right of it or below."""
    return ~(_follows(x, y, 1) & _follows(x, y, 0))


def _closed(plane: Floats, x: TileTexels, y: TileTexels, blur: float | None) -> Floats:
    """Solve for one map by FFT; with `blur` None its mean is kept."""
    shown = plane[y, x].astype(np.float64)
    divergence = np.zeros_like(shown)
    for axis in (1, 0):
        step = _steps(plane, shown, x, y, axis)
        divergence += step - np.roll(step, 1, axis)
    turns = [np.cos(2.0 * np.pi * np.fft.fftfreq(shown.shape[0]))[:, None]]
    turns += [np.cos(2.0 * np.pi * np.fft.rfftfreq(shown.shape[1]))[None, :]]
    laplacian = 4.0 - 2.0 * turns[0] - 2.0 * turns[1]
    screening = 0.0 if blur is None else 1.0 / blur**2
    waves = np.fft.rfft2(screening * shown - divergence)
    if blur is None:
        laplacian[0, 0] = 1.0
        waves[0, 0] = shown.sum()
    return np.fft.irfft2(waves / (laplacian + screening), s=shown.shape).astype(np.float32)


def _steps(
    plane: Floats, shown: NDArray[np.float64], x: TileTexels, y: TileTexels, axis: int
) -> NDArray[np.float64]:
    """(h, w) difference from each texel to the next along an axis.

    Across a seam it is the mean of the differences that the exemplar has on both sides.
    """
    step = np.roll(shown, -1, axis) - shown
    rows, columns = np.nonzero(~_follows(x, y, axis))
    high, wide = plane.shape
    right, down = (1, 0) if axis == 1 else (0, 1)
    here = y[rows, columns], x[rows, columns]
    after = (rows + down) % x.shape[0], (columns + right) % x.shape[1]
    there = y[after], x[after]
    rise, sides = np.zeros(len(rows)), np.zeros(len(rows))
    for (row, column), direction in ((here, 1), (there, -1)):
        other = row + direction * down, column + direction * right
        known = (other[0] >= 0) & (other[0] < high) & (other[1] >= 0) & (other[1] < wide)
        other = other[0].clip(0, high - 1), other[1].clip(0, wide - 1)
        rise += np.where(known, direction * (plane[other] - plane[row, column]), 0.0)
        sides += known
    step[rows, columns] = np.where(sides > 0, rise / np.maximum(sides, 1), step[rows, columns])
    return step


def _follows(x: TileTexels, y: TileTexels, axis: int) -> NDArray[np.bool_]:
    """(h, w) whether the next texel along an axis, on the torus, is the exemplar's next one."""
    right, down = (1, 0) if axis == 1 else (0, 1)
    following = (np.roll(x, -1, axis) - x == right) & (np.roll(y, -1, axis) - y == down)
    return np.asarray(following)


# Source of blocks from periodic maps held in memory.

BLOCKS = Grid(1024, 256)  # wider than a decoder's: for small blocks most time goes into the margin


@dataclass(frozen=True)
class RepeatedSource(ArraySource):
    """A seamless tile, repeated; picklable."""

    stacked: Floats
    """(6 or 8, h, w) maps of the tile."""
    texel_size: float
    """Side of a texel in plane units."""
    grid: Grid = BLOCKS

    @property
    def period(self) -> Period:
        """The tile's sides, in texels."""
        return self.stacked.shape[2], self.stacked.shape[1]

    @property
    def specular_channels(self) -> int:
        """Channels of F0: 1, or 3 where it has a colour."""
        return len(self.stacked[SPECULAR])

    def around(self, area: Rectangle) -> Floats:
        """Stacked maps (6 or 8, height, width) of any area."""
        rows = np.arange(area.y, area.y + area.height) % self.stacked.shape[1]
        columns = np.arange(area.x, area.x + area.width) % self.stacked.shape[2]
        return self.stacked[:, rows[:, None], columns[None, :]]


# Makes a seamless tile of the exemplar itself, which shows each of its texels at most once.
#
# 1. Low frequencies of albedo, F0 and roughness are removed (repeat.py).
# 2. A lattice is straightened (straighten.py).
# 3. The two shifts are found after which the exemplar is most like itself (straighten.py).
# 4. Copies shifted by these are joined along seams of least difference in all maps (straighten.py).
# 5. What still differs at the seams is blended (repeat.py).

_DISORDERED = 1.15  # factor on the cost of shifts that do not keep the lattice
_CALM = 1.0  # largest step across the tile's border over the mean step, in any map; see _usual_line

_LEAST = 32  # least side of an exemplar, texels


@dataclass(frozen=True)
class Repeated:
    """A seamless tile."""

    maps: Floats
    """(6, h, w) stacked: diffuse, specular, roughness, height; 8 where F0 has a colour."""
    cut: NDArray[np.bool_]
    """(h, w) whether a seam lies between a texel and the one right of it or below."""


def repeated(
    maps: Floats, texel_size: float, lattice: PhasedLattice | None = None, bits: int = 0
) -> Repeated:
    """Make a seamless tile, each side about three quarters of the exemplar's.

    Args:
        maps: (6 or 8, H, W) stacked: diffuse, specular, roughness, height.
        texel_size: in plane units.
        lattice: of the exemplar, or None.
        bits: the lattice is in texels 2^bits as large.

    Raises:
        UsageError: a side of less than _LEAST texels.
    """
    height, width = maps.shape[1:]
    if min(height, width) < _LEAST:
        raise UsageError.at(
            "--tile piece",
            f"an exemplar of {width} x {height} texels is too small to repeat",
            f"capture it with at least {_LEAST} texels per side, or give --tile alone",
        )
    level = flatten(maps)
    across, down, cost = _shifts(_seen(level, texel_size), ())
    if lattice is not None:
        straight = unbent(level, lattice, bits)
        waves = tuple((fx / 2**bits, fy / 2**bits) for fx, fy in lattice.waves)
        *ordered, ordered_cost = _shifts(_seen(straight, texel_size), waves)
        if ordered_cost <= _DISORDERED * cost:
            level, (across, down) = straight, ordered
    straight, along, below = sheared(level, across, down)
    tile, cut = cut_and_joined(straight, texel_size, along, below)
    begins = _usual_line(tile, 1), _usual_line(tile, 2)
    return Repeated(np.roll(tile, begins, (1, 2)), np.roll(cut, begins, (0, 1)))


def cut_and_joined(
    straight: Floats, texel_size: float, along: int, below: int
) -> tuple[Floats, NDArray[np.bool_]]:
    """(6 or 8, below, along) seamless maps, and (below, along) where their seams are.

    Args:
        straight: stacked maps whose shifts are along the axes.
        texel_size: in plane units.
        along, below: lengths of the shifts, texels.
    """
    x, y = _places(_seen(straight, texel_size), along, below)
    return joined(straight, x, y), is_cut(x, y)


def _shifts(seen: Planes, waves: tuple[Frequency, ...]) -> tuple[Shift, Shift, float]:
    """The shifts (x, y) that are about along x and about along y, and the cost of their seams."""
    turned = _turned(seen)
    turned_waves = tuple((fy, fx) for fx, fy in waves)
    across, down = best_shift(seen, waves), best_shift(turned, turned_waves)
    # Equal and opposite slants are a rotation; any more would shear the exemplar too much.
    if not waves and abs(across.slant + down.slant) > STRETCH:
        if abs(across.slant) > abs(down.slant):
            down = best_shift(turned, (), -across.slant, STRETCH)
        else:
            across = best_shift(seen, (), -down.slant, STRETCH)
    return across.shift, (down.shift[1], down.shift[0]), across.cost + down.cost


def _places(seen: Planes, along: int, below: int) -> tuple[TileTexels, TileTexels]:
    """(below, along) texels x, y of the exemplar that the tile shows."""
    rows, columns = np.arange(below), np.arange(seen.shape[2])
    # First a horizontal seam over the whole width, then a vertical one that repeats with the tile.
    first, second = copies(_turned(seen), below)
    upper, _ = least_cut(_rms_difference(first, second), LENGTH, closed=False)
    down = rows[:, None] + below * (rows[:, None] < upper[None, :])
    first, second = copies(seen[:, down, columns[None, :]], along)
    left, _ = least_cut(_rms_difference(first, second), LENGTH, closed=True)
    across = columns[None, :along] + along * (columns[None, :along] < left[:, None])
    return across, down[rows[:, None], across]


def _usual_line(maps: Floats, axis: int) -> int:
    """How far to roll the tile along an axis so that the steps across its border are usual ones.

    The border may lie at an edge of the texture, such as a joint of tiles. It is moved to the
    nearest line at which all maps differ no more than _CALM times their mean difference.
    """
    steps = np.abs(np.roll(maps, -1, axis) - maps).mean(axis=3 - axis)
    usual = steps.mean(axis=1, keepdims=True)
    least = 1e-6 * np.abs(maps).max(axis=(1, 2))[:, None] + 1e-12
    worst = (steps / np.maximum(usual, least)).max(0)
    reach = len(worst) // 2
    # Step i is between lines i and i + 1, the last one that across the border.
    distance = np.abs(np.arange(-1 - reach, reach) + 1)
    near = np.arange(-1 - reach, reach)
    lattice = np.argsort(distance, kind="stable")
    calm = [int(near[i]) for i in lattice if worst[near[i]] <= _CALM]
    chosen = calm[0] if calm else int(near[np.argmin(worst[near])])
    return -(chosen + 1)


def _seen(maps: Floats, texel_size: float) -> Planes:
    """(7, H, W) planes that copies are compared by: all but height, in standard deviations."""
    parts = maps[DIFFUSE], maps[SPECULAR], maps[ROUGHNESS], maps[HEIGHT]
    planes = planes_of_maps(parts, texel_size)
    scale = choose_scale(planes)
    factors = scale.factors / np.float32(UNIT)
    return ((planes - scale.offsets[:, None, None]) * factors[:, None, None])[:-1]


def _rms_difference(first: Planes, second: Planes) -> NDArray[np.float32]:
    return np.sqrt(np.square(first - second).mean(axis=0))


def _turned(planes: Planes) -> Planes:
    return np.ascontiguousarray(planes.transpose(0, 2, 1))
