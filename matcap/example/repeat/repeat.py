"""Makes a seamless tile of the exemplar itself, which shows each of its texels at most once.

1. Low frequencies of albedo, F0 and roughness are removed (flatten.py).
2. A lattice is straightened (straighten.py).
3. The two shifts are found after which the exemplar is most like itself (shifts.py).
4. Copies shifted by these are joined along seams of least difference in all maps (cut.py).
5. What still differs at the seams is blended (join.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.errors import UsageError
from matcap.example.exemplar import DIFFUSE, HEIGHT, ROUGHNESS, SPECULAR, Floats
from matcap.example.features import UNIT, choose_scale, planes_of_maps
from matcap.example.lattice import Frequency, PhasedLattice
from matcap.example.repeat.cut import least_cut
from matcap.example.repeat.flatten import flatten
from matcap.example.repeat.join import TileTexels, is_cut, joined
from matcap.example.repeat.shifts import LENGTH, STRETCH, Planes, Shift, best_shift, copies
from matcap.example.repeat.straighten import sheared, unbent

# The seamless tile; docs/notes/field.md.
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
    seen = _seen(level, texel_size)
    across, down, cost = _shifts(seen, ())
    if lattice is not None:
        straight = unbent(level, lattice, bits)
        waves = tuple((fx / 2**bits, fy / 2**bits) for fx, fy in lattice.waves)
        *ordered, ordered_cost = _shifts(_seen(straight, texel_size), waves)
        if ordered_cost <= _DISORDERED * cost:
            level, (across, down) = straight, ordered
    straight, along, below = sheared(level, across, down)
    seen = _seen(straight, texel_size)
    x, y = _places(seen, along, below)
    tile, cut = joined(straight, x, y), is_cut(x, y)
    begins = _usual_line(tile, 1), _usual_line(tile, 2)
    return Repeated(np.roll(tile, begins, (1, 2)), np.roll(cut, begins, (0, 1)))


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
    shown = seen[:, down, columns[None, :]]
    first, second = copies(shown, along)
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
    worst = (steps / np.maximum(usual, 1e-6 * np.abs(maps).max(axis=(1, 2))[:, None] + 1e-12)).max(
        0
    )
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
    planes = planes_of_maps(
        (maps[DIFFUSE], maps[SPECULAR], maps[ROUGHNESS], maps[HEIGHT]), texel_size
    )
    scale = choose_scale(planes)
    factors = scale.factors / np.float32(UNIT)
    return ((planes - scale.offsets[:, None, None]) * factors[:, None, None])[:-1]


def _rms_difference(first: Planes, second: Planes) -> NDArray[np.float32]:
    return np.sqrt(np.square(first - second).mean(axis=0))


def _turned(planes: Planes) -> Planes:
    return np.ascontiguousarray(planes.transpose(0, 2, 1))
