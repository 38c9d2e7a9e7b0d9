"""Patches of the coarsest level: the grid they are laid on, and the place that each shows.

Larger patches tear long structure less often. They are fitted to their neighbours: of several
random places the one with the least border mismatch is taken. Patches of even row and even column
are random; those between two of these along a row or a column are fitted to them; those of odd row
and odd column are fitted to all four neighbours. A patch thus depends on its neighbours' neighbours
at most, whatever else has been synthesised.

Patches may begin anywhere in the exemplar and continue across its borders on the opposite side, so
that all of it is shown equally often: patches inside it show its middle most, and a stain there in
nearly every patch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from matcap.example.candidates import Frame
from matcap.example.index import Level
from matcap.example.library import Hashes, hash_places
from matcap.example.placement import Placement, drawn, reuse_cost
from matcap.field.turns import Integers

# Patches of the coarsest level, and corrections; docs/notes/field.md.
_ALONG = 32  # most places along a border at which patches are compared
_SIDES = ((-1, 0), (1, 0), (0, -1), (0, 1))  # columns and rows to a patch's neighbours
_CORNERS = ((-1, -1), (1, -1), (-1, 1), (1, 1))


@dataclass(frozen=True)
class Axis:
    """Patches along one axis."""

    number: Integers
    """Number of the patch of each column or row, modulo `count`."""
    offset: Integers
    """Texels from the patch's centre."""
    side: int
    """Width or height of a patch, texels."""
    count: int | None
    """Patches in the period, or None."""

    @staticmethod
    def of(at: Integers, side: int, period: int | None) -> Axis:
        """Patches, of at most `side` texels, of the positions `at`, which are modulo the period."""
        if period is None:
            return Axis(at // side, at % side - side // 2, side, None)
        count = -(-period // side)
        number = at * count // period
        begins = -(-number * period // count)
        whole = -(-period // count)
        return Axis(number, at - begins - whole // 2, whole, count)

    def alike(self) -> Axis:
        """The same axis with one patch in place of all."""
        return replace(self, number=np.zeros_like(self.number))


def lay_patches(
    level: Level, placement: Placement, depth: int, seed: int, frame: Frame, axes: tuple[Axis, Axis]
) -> tuple[Integers, Integers]:
    """(rows, columns) x, y of the exemplar that each position shows.

    Args:
        level: the coarsest.
        placement: costs of the patches' centres.
        depth: its number.
        seed: in [-2^63, 2^63).
        frame: of the places, whose opposite borders adjoin (Lookup.joined).
        axes: patches along columns and rows.
    """
    across, down = axes
    columns, rows = _with_neighbours(across), _with_neighbours(down)
    hashes = hash_places(seed, depth, columns[None, :], rows[:, None])
    x, y = placement.cheapest(hashes, frame)
    sides = across.side, down.side
    odd_columns, odd_rows = np.flatnonzero(columns % 2), np.flatnonzero(rows % 2)
    even_columns, even_rows = np.flatnonzero(columns % 2 == 0), np.flatnonzero(rows % 2 == 0)

    def fit(some_rows: Integers, some_columns: Integers) -> None:
        if not (some_rows.size and some_columns.size):
            return
        at = np.ix_(some_rows, some_columns)
        odd = int(columns[some_columns[0]]) % 2, int(rows[some_rows[0]]) % 2
        neighbours = []
        for step in _SIDES if placement.rule < 3 else _SIDES + _CORNERS:
            if any(abs(by) > is_odd for by, is_odd in zip(step, odd, strict=True)):
                continue  # even along this axis: not fitted along it
            there = np.ix_(
                _moved(rows, some_rows, down, step[1]),
                _moved(columns, some_columns, across, step[0]),
            )
            neighbours.append(_Neighbour(step, x[there], y[there]))
        x[at], y[at] = _fitting(level, placement, hashes[at], frame, neighbours, sides)

    fit(even_rows, odd_columns)
    fit(odd_rows, even_columns)
    fit(odd_rows, odd_columns)
    chosen = np.ix_(np.searchsorted(rows, down.number), np.searchsorted(columns, across.number))
    x, y = x[chosen] + across.offset, y[chosen] + down.offset[:, None]
    return _within(x, frame.left, frame.right), _within(y, frame.top, frame.bottom)


def _moved(numbers: Integers, chosen: Integers, axis: Axis, by: int) -> Integers:
    """Indices of the patches a step beyond the chosen ones."""
    wanted = numbers[chosen] + by
    return np.searchsorted(numbers, wanted if axis.count is None else wanted % axis.count)


def _within(at: Integers, first: int, last: int) -> Integers:
    """Positions modulo the length of [first, last], in it."""
    return first + (at - first) % (last - first + 1)


def inset(frame: Frame, by_x: int, by_y: int) -> Frame:
    """A frame reduced on every side, to no less than its middle."""
    by_x = min(by_x, (frame.right - frame.left) // 2)
    by_y = min(by_y, (frame.bottom - frame.top) // 2)
    return Frame(frame.left + by_x, frame.top + by_y, frame.right - by_x, frame.bottom - by_y)


@dataclass(frozen=True)
class _Neighbour:
    """Neighbouring patches on one side."""

    step: tuple[int, int]
    """Columns and rows of patches to them, each -1, 0 or 1."""
    x: Integers
    """Places at their centres."""
    y: Integers


def _fitting(
    level: Level,
    placement: Placement,
    hashes: Hashes,
    frame: Frame,
    neighbours: list[_Neighbour],
    sides: tuple[int, int],
) -> tuple[Integers, Integers]:
    """For every hash, the random place of least placement cost, border mismatch and reuse."""
    wrap = frame.right - frame.left + 1, frame.bottom - frame.top + 1
    tried = [drawn(hashes, attempt, frame) for attempt in range(placement.fitted)]
    x, y = (np.stack(each) for each in zip(*tried, strict=True))
    cost = placement.at(x, y).astype(np.int64)
    for other in neighbours:
        if 0 in other.step:
            cost += _border_mismatch(level, frame, (x, y), other, *sides)
        if placement.near:
            in_field = -other.step[0] * sides[0], -other.step[1] * sides[1]
            shift = x - other.x, y - other.y
            cost += reuse_cost(shift, in_field, sides, placement.near, wrap)
    best = cost.argmin(axis=0)[None]
    best_x, best_y = (np.take_along_axis(each, best, axis=0)[0] for each in (x, y))
    return best_x, best_y


def _border_mismatch(
    level: Level,
    frame: Frame,
    centre: tuple[Integers, Integers],
    other: _Neighbour,
    width: int,
    height: int,
) -> Integers:
    """32 times the mean squared difference of both sides' appearance along the common border."""
    along_x = other.step[1] == 0
    long, short = (height, width) if along_x else (width, height)
    step = max(level.spacing, long // _ALONG)
    along = np.arange(-(long // 2), long - long // 2, step)
    zero = np.zeros_like(along)
    edge = zero + sum(other.step) * (short // 2)
    dx, dy = (edge, along) if along_x else (along, edge)
    back_x, back_y = (-edge, along) if along_x else (along, -edge)

    def appearance_at(x: Integers, y: Integers) -> NDArray[np.int32]:
        x = _within(x, frame.left, frame.right) >> level.bits
        y = _within(y, frame.top, frame.bottom) >> level.bits
        return level.appearance[y, x].astype(np.int32)

    here = appearance_at(centre[0][..., None] + dx, centre[1][..., None] + dy)
    there = appearance_at(other.x[..., None] + back_x, other.y[..., None] + back_y)
    squares = np.square(here - there).sum(axis=-1, dtype=np.int64)
    return squares.sum(axis=-1) * 32 // len(along)


def _with_neighbours(axis: Axis) -> Integers:
    """Sorted numbers of patches, including the neighbours that odd ones are fitted to."""
    numbers = np.unique(axis.number)
    odd = numbers[numbers % 2 == 1]
    near = np.concatenate([odd - 1, odd + 1])
    return np.unique(np.concatenate([numbers, near if axis.count is None else near % axis.count]))
