"""The periods of a seamless tile: shifts of largest self-similarity, minimum-cost cuts, and maps
made straight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import Floats
from matcap.example.lattice import GRID, Frequency, PhasedLattice

# Minimum-cost seam through the overlap of two copies of an exemplar [kwatra2003].
#
# The seam crosses every row once and may run any distance along a row, at the cost of the texels it
# passes. Dynamic programming finds the exact minimum.

CutColumns = NDArray[np.int64]


def least_cut(
    differences: NDArray[np.floating], length: float, *, closed: bool
) -> tuple[CutColumns, float]:
    """The seam of least cost from the first row to the last.

    Args:
        differences: (rows, columns) of both copies, at least 0; at least two columns.
        length: cost of each step of the seam, added to the differences.
        closed: the rows are periodic, and the seam ends where it began.

    Returns:
        (rows,) first column of the second copy, at least 1; and the mean cost a row.
    """
    between = differences[:, 1:] + differences[:, :-1] + length  # between columns c and c + 1
    following = np.roll(differences, -1, axis=0)
    # Cumulative cost of running along the border between a row and the next.
    passed = np.cumsum(differences + following + length, axis=1)[:, :-1]
    if not closed:
        columns, cost = _through(between, passed)
        return columns + 1, cost / len(between)
    # A closed seam is searched from a column that a seam of two periods crosses in its middle.
    twice, _ = _through(np.tile(between, (2, 1)), np.tile(passed, (2, 1)))
    start = int(twice[len(between)])
    columns, cost = _through(between, passed, start)
    cost += abs(float(passed[-1, columns[-1]] - passed[-1, start]))
    return columns + 1, cost / len(between)


def _through(
    between: NDArray[np.floating], passed: NDArray[np.floating], start: int | None = None
) -> tuple[CutColumns, float]:
    """Columns of the cheapest seam, and its cost; with a `start` it begins and ends there."""
    rows, columns = between.shape
    best = between[0].astype(np.float64)
    if start is not None:
        best = np.full(columns, np.inf)
        best[start] = between[0, start]
    came = np.zeros((rows, columns), np.int64)
    order = np.arange(columns)
    for row in range(1, rows):
        way = passed[row - 1]
        rightwards, from_left = _least(best - way, order)
        leftwards, from_right = _least((best + way)[::-1], order)
        leftwards, from_right = leftwards[::-1] - way, columns - 1 - from_right[::-1]
        rightwards = rightwards + way
        left = rightwards <= leftwards
        came[row] = np.where(left, from_left, from_right)
        best = np.where(left, rightwards, leftwards) + between[row]
    ends = best if start is None else best + np.abs(passed[-1] - passed[-1, start])
    path = np.empty(rows, np.int64)
    path[-1] = int(np.argmin(ends))
    for row in range(rows - 1, 0, -1):
        path[row - 1] = came[row, path[row]]
    return path, float(best[path[-1]])


def _least(
    values: NDArray[np.float64], order: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Running minimum of values, and the index of its first occurrence."""
    least = np.minimum.accumulate(values)
    fresh = np.concatenate([[True], values[1:] < least[:-1]])
    return least, np.maximum.accumulate(np.where(fresh, order, 0))


# Shifts after which an exemplar is most like itself: candidates of the tile's period.

# The seamless tile; docs/notes/field.md.
_LEAST = 0.66  # least share of a side that the tile keeps. Less gives more shifts to choose from.
_MOST = 0.92  # largest share; the rest is overlap for the seam
STRETCH = 0.02  # largest change of a shift to whole turns of a lattice, as a share of the shift
_SEARCH = 320  # texels of the exemplar's longer side in the search for shifts
_MOST_TURN = 0.06  # largest dy / dx of a shift
# Factor on the cost of a slanted shift, as resampling loses some of the finest detail.
_SLANTED = 1.15
_CANDIDATES = 8  # shifts whose seams are compared
_LARGER = 0.6  # reduction of the relative cost for a shift as long as the side
LENGTH = 0.1  # cost of a step of the seam, standard deviations of a feature; it keeps seams short

Planes = NDArray[np.float32]
Shift = tuple[float, float]  # texels along x (right) and y (down)


@dataclass(frozen=True)
class RatedShift:
    """A shift, and the cost a row of its best seam."""

    shift: Shift
    cost: float

    @property
    def slant(self) -> float:
        """Dy / dx of the shift."""
        return self.shift[1] / self.shift[0]


@dataclass(frozen=True)
class _Candidate:
    """A shift, and the mean squared difference of both copies over their overlap."""

    shift: Shift
    difference: float


def best_shift(
    planes: Planes, waves: tuple[Frequency, ...], slant: float = 0.0, slack: float = _MOST_TURN
) -> RatedShift:
    """The shift, about along x, whose best seam costs least.

    The cost is relative to the median candidate's, higher for slanted shifts, and less the longer
    the shift, which keeps more of the exemplar.

    Args:
        planes: (C, H, W) to compare, in standard deviations; with a lattice, straightened.
        waves: of the lattice, cycles per texel; the shift is a whole number of turns of each.
        slant: dy / dx of a shift that does not count as slanted.
        slack: largest difference from that slant, without a lattice.
    """
    scale = _scale(planes)
    small = square_means(planes, scale)
    width = planes.shape[2]
    table = _differences(small, slant, slack, _LEAST)
    straight = list(_ordered(table, scale, width, waves)) if waves else []
    others = []
    if not straight:
        straight, others = list(_straight(table, scale, slant)), list(_any(table, scale))
    usual = float(np.median(table.values)) + 1e-12
    rated = [
        RatedShift(one.shift, _cost(small, one.shift, scale))
        for some in (straight, others)
        for one in _likeliest(some, usual, width, scale)
    ]
    middle = float(np.median([one.cost for one in rated])) + 1e-12
    is_straight = {one.shift for one in straight}

    def score(one: RatedShift) -> float:
        dearer = 1.0 if one.shift in is_straight else _SLANTED
        return dearer * one.cost / middle - _LARGER * one.shift[0] / width

    best = min(rated, key=score)
    return best if waves else RatedShift(_refined(planes, best.shift, scale), best.cost)


def likest_shift(planes: Planes, least: float) -> Shift:
    """The shift, about along x, after which planes differ least.

    Args:
        planes: (C, H, W) to compare, in standard deviations.
        least: share of the width that it has at least.
    """
    scale = _scale(planes)
    table = _differences(square_means(planes, scale), 0.0, _MOST_TURN, least)
    return _refined(planes, min(_any(table, scale), key=lambda one: one.difference).shift, scale)


def _scale(planes: Planes) -> int:
    """Texels that are averaged for the search for shifts."""
    return 1 << max(0, math.ceil(math.log2(max(planes.shape[1:]) / _SEARCH)))


def _likeliest(some: list[_Candidate], usual: float, width: int, scale: int) -> list[_Candidate]:
    """The _CANDIDATES shifts of least difference, no two of them adjacent."""
    ranked = sorted(some, key=lambda one: one.difference / usual - _LARGER * one.shift[0] / width)
    separate: list[_Candidate] = []
    for one in ranked:
        if len(separate) == _CANDIDATES:
            break
        if all(np.abs(np.subtract(one.shift, other.shift)).max() > scale for other in separate):
            separate.append(one)
    return separate


@dataclass(frozen=True)
class _Table:
    """Mean squared differences of copies shifted by (left + column, top + row) texels."""

    values: NDArray[np.float64]
    left: int
    top: int


def _differences(planes: Planes, slant: float, slack: float, least: float) -> _Table:
    """Differences for all allowed shifts, by FFT."""
    _, high, wide = planes.shape
    first, last = math.ceil(least * wide), math.floor(_MOST * wide)
    sides = (2 * high, 2 * wide)
    waves = np.fft.rfft2(planes.astype(np.float64), s=sides)
    squares = np.fft.rfft2(np.square(planes, dtype=np.float64).sum(axis=0), s=sides)
    ones = np.fft.rfft2(np.ones((high, wide)), s=sides)
    # Sum over the overlap of a(p + s)^2 + a(p)^2 - 2 a(p + s) a(p).
    both = np.fft.irfft2(squares * ones.conj() + ones * squares.conj(), s=sides)
    both -= 2.0 * np.fft.irfft2((waves * waves.conj()).sum(axis=0), s=sides)
    top, bottom = math.floor((slant - slack) * wide), math.ceil((slant + slack) * wide)
    rows = np.arange(top, bottom + 1)
    columns = np.arange(first, max(last, first) + 1)
    count = (high - np.abs(rows))[:, None] * (wide - columns)[None, :]
    values = both[rows % sides[0]][:, columns] / (count * len(planes))
    return _Table(np.maximum(values, 0.0), first, top)


def _straight(table: _Table, scale: int, slant: float) -> Iterator[_Candidate]:
    """Shifts of exactly this slant."""
    for column in range(table.values.shape[1]):
        along = table.left + column
        down = round(slant * along)
        shift = (float(along * scale), float(down * scale))
        yield _Candidate(shift, float(table.values[down - table.top, column]))


def _any(table: _Table, scale: int) -> Iterator[_Candidate]:
    """All shifts of the table."""
    for (row, column), value in np.ndenumerate(table.values):
        shift = (float((table.left + column) * scale), float((row + table.top) * scale))
        yield _Candidate(shift, float(value))


def _ordered(
    table: _Table, scale: int, width: int, waves: tuple[Frequency, ...]
) -> Iterator[_Candidate]:
    """Shifts nearest to horizontal ones that are whole turns of every wave."""
    turns = np.array(waves)
    back = np.linalg.pinv(turns)
    low, high = math.ceil(_LEAST * width), math.floor(_MOST * width)
    seen = set()
    for along in range(low, high + 1):
        straight = np.array([along, 0.0])
        shift = straight + back @ (np.rint(turns @ straight) - turns @ straight)
        if np.abs(shift - straight).max() > STRETCH * along:
            continue
        name = (round(shift[0]), round(shift[1]))
        if name in seen or not low <= shift[0] <= high:
            continue
        seen.add(name)
        row, column = round(shift[1] / scale) - table.top, round(shift[0] / scale) - table.left
        row, column = (
            min(max(place, 0), size - 1)
            for place, size in zip((row, column), table.values.shape, strict=True)
        )
        yield _Candidate((float(shift[0]), float(shift[1])), float(table.values[row, column]))


def _cost(planes: Planes, shift: Shift, scale: int) -> float:
    """Cost a row of the best seam between the exemplar and its shifted copy."""
    along, down = round(shift[0] / scale), round(shift[1] / scale)
    first, second = copies(planes, along, down)
    return least_cut(np.sqrt(np.square(first - second).mean(axis=0)), LENGTH, closed=False)[1]


def copies(planes: Planes, along: int, down: int = 0) -> tuple[Planes, Planes]:
    """The shifted and the unshifted planes over their overlap."""
    high, wide = planes.shape[1:]
    top, bottom = max(0, -down), min(high, high - down)
    return planes[:, top + down : bottom + down, along:], planes[:, top:bottom, : wide - along]


def _refined(planes: Planes, shift: Shift, scale: int) -> Shift:
    """The shift of least difference within `scale` texels of one found at 1 / scale resolution."""
    if scale == 1:
        return shift
    most = planes.shape[2] - 8
    best = (math.inf, shift)
    rows = range(-scale, scale + 1) if shift[1] else range(1)
    for row in rows:
        for column in range(-scale, scale + 1):
            along, down = min(round(shift[0]) + column, most), round(shift[1]) + row
            first, second = copies(planes, along, down)
            difference = float(np.square(first[:, ::2, ::2] - second[:, ::2, ::2]).mean())
            best = min(best, (difference, (float(along), float(down))))
    return best[1]


def square_means(planes: NDArray[Any], side: int) -> NDArray[Any]:
    """(C, H // side, W // side) means of planes over squares of `side` texels."""
    rows, columns = (n // side for n in planes.shape[1:])
    cut = planes[:, : rows * side, : columns * side]
    return cut.reshape(len(planes), rows, side, columns, side).mean(axis=(2, 4))


# Resampling of maps so that a lattice and a tile's shifts are straight.

_TURN = 2.0**16
_BENT = 0.25  # texels: smaller displacements are not resampled


def unbent(maps: Floats, lattice: PhasedLattice, bits: int = 0) -> Floats:
    """Maps resampled so that their lattice is straight, of the same mean waves.

    The displacement is the least one that removes the phase offsets. Borders are cropped, so that
    the result is smaller.

    Args:
        maps: (C, H, W).
        lattice: of the maps, in texels 2^bits as large.
    """
    turns = lattice.phase_offsets / _TURN
    turns = turns - turns.mean(axis=(1, 2), keepdims=True)
    move = displacement(lattice.waves, turns) * 2.0**bits
    if np.abs(move).max() < _BENT:
        return maps
    height, width = maps.shape[1:]
    return _read_inside(maps, *sources(move, 1 << (GRID + bits), (width, height)))


def displacement(waves: Sequence[Frequency], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, rows, columns) the least move, x and y in texels, with phases straight at p + move(p).

    Args:
        waves: mean frequency vectors, cycles per texel.
        turns: (waves, rows, columns) phase offsets from these.
    """
    return np.asarray(np.einsum("dw,wyx->dyx", np.linalg.pinv(np.array(waves)), turns))


def sources(
    move: NDArray[np.float64], step: int, size: tuple[int, int], rounds: int = 1
) -> tuple[Floats, Floats]:
    """(H, W) x and y of the points p whose p + move(p) is each texel.

    Args:
        move: (2, rows, columns) texels, at every `step` texels.
        size: (width, height) of the maps.
        rounds: of the fixed-point iteration from p = texel; more where the move is long.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    width, height = size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    from_x, from_y = x, y
    for _ in range(rounds):
        grid = from_x / np.float32(step), from_y / np.float32(step)
        across, down = (
            cv2.remap(
                part.astype(np.float32), *grid, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            for part in move
        )
        from_x, from_y = x - across, y - down
    return from_x, from_y


def sheared(maps: Floats, across: Shift, down: Shift, multiple: int = 1) -> tuple[Floats, int, int]:
    """Maps resampled so that two shifts are along the axes, and the shifts' lengths.

    Args:
        maps: (C, H, W).
        across: shift (x, y) that becomes horizontal.
        down: shift (x, y) that becomes vertical.
        multiple: of texels, that lengths become.

    Returns:
        Maps; length of `across`; length of `down`, in whole texels.
    """
    along, below = (
        multiple * max(1, round(math.hypot(*shift) / multiple)) for shift in (across, down)
    )
    matrix = np.array([[across[0] / along, down[0] / below], [across[1] / along, down[1] / below]])
    if np.abs(matrix - np.eye(2)).max() * max(along, below) < _BENT:
        return maps, along, below
    height, width = maps.shape[1:]
    x, y = np.meshgrid(np.arange(width) - 0.5 * (width - 1), np.arange(height) - 0.5 * (height - 1))
    from_x = matrix[0, 0] * x + matrix[0, 1] * y + 0.5 * (width - 1)
    from_y = matrix[1, 0] * x + matrix[1, 1] * y + 0.5 * (height - 1)
    return _read_inside(maps, from_x, from_y), along, below


def _inside(inside: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Slices of the largest centred rectangle whose border is all inside, or of the middle."""
    height, width = inside.shape
    most = min(height, width) // 4
    for cut in range(most):
        part = inside[cut : height - cut, cut : width - cut]
        if part[0].all() and part[-1].all() and part[:, 0].all() and part[:, -1].all():
            return slice(cut, height - cut), slice(cut, width - cut)
    return slice(most, height - most), slice(most, width - most)


def _read_inside(maps: Floats, x: NDArray[np.floating], y: NDArray[np.floating]) -> Floats:
    """Maps interpolated at texels (x, y), cropped to where these lie inside.

    At most a quarter of the shorter side is cropped at each border; beyond, borders are repeated.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    height, width = maps.shape[1:]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    rows, columns = _inside(inside)
    at = np.asarray(x[rows, columns], np.float32), np.asarray(y[rows, columns], np.float32)
    read = [cv2.remap(p, *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE) for p in maps]
    planes = np.stack(read).astype(np.float32, copy=False)
    np.clip(planes[:-1], 0.0, 1.0, out=planes[:-1])
    return planes
