"""Patches of the coarsest level: the grid they are laid on and the place each one shows.

A field of full variety begins with squares of some hundred texels, each anywhere. With less,
pieces are larger, up to the whole exemplar, which is then repeated: what is long in it is torn
less often. Every other piece is fitted to its neighbours: of several drawn, it is the one whose
borders continue them best. Pieces of even row and column are free; those between two of them in a
row or a column fit these; those of odd row and column fit all four. So a piece depends on no more
than its neighbours' neighbours, and on nothing that was made before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.grids import PRICE_BITS, Frame
from matcap.example.hashing import Hashes, draw, hash_places
from matcap.example.lookup import Level
from matcap.example.order import Integers
from matcap.example.tuned import PLACEMENT


@dataclass(frozen=True)
class Axis:
    """Pieces along columns or rows."""

    number: Integers
    """Of the piece that each column or row lies in; wrapped as the field is."""
    offset: Integers
    """Texels from the middle of it."""
    side: int
    """Texels of a piece."""
    count: int | None
    """Pieces until the field repeats, or None."""

    @staticmethod
    def of(at: Integers, side: int, period: int | None) -> Axis:
        """PieceSizes texels `at`, which lie within the period, into pieces of at most a side."""
        if period is None:
            return Axis(at // side, at % side - side // 2, side, None)
        count = -(-period // side)
        number = at * count // period
        begins = -(-number * period // count)
        whole = -(-period // count)
        return Axis(number, at - begins - whole // 2, whole, count)


def laid(
    level: Level, depth: int, seed: int, across: Axis, down: Axis
) -> tuple[Integers, Integers]:
    """(rows, columns) places x, y of the exemplar in the middle of every piece named."""
    columns, rows = _with_neighbours(across), _with_neighbours(down)
    frame = inset(level.frame, across.side // 2, down.side // 2)
    hashes = hash_places(seed, depth, columns[None, :], rows[:, None])
    x, y = cheapest(level, hashes, frame)
    odd_columns, odd_rows = np.flatnonzero(columns % 2), np.flatnonzero(rows % 2)
    even_columns, even_rows = np.flatnonzero(columns % 2 == 0), np.flatnonzero(rows % 2 == 0)

    def fit(some_rows: Integers, some_columns: Integers) -> None:
        if not (some_rows.size and some_columns.size):
            return
        at = np.ix_(some_rows, some_columns)
        neighbours = []
        for along_x, step in ((True, -1), (True, 1), (False, -1), (False, 1)):
            numbers, axis, chosen = (
                (columns, across, some_columns) if along_x else (rows, down, some_rows)
            )
            if not int(numbers[chosen[0]]) % 2:
                continue  # fitted to the others of its row or column alone
            wanted = numbers[chosen] + step
            wanted = wanted if axis.count is None else wanted % axis.count
            other = np.searchsorted(numbers, wanted)
            there = np.ix_(some_rows, other) if along_x else np.ix_(other, some_columns)
            neighbours.append(_Neighbour(along_x, step, x[there], y[there]))
        x[at], y[at] = _fitting(level, hashes[at], frame, neighbours, across.side, down.side)

    fit(even_rows, odd_columns)
    fit(odd_rows, even_columns)
    fit(odd_rows, odd_columns)
    chosen = np.ix_(np.searchsorted(rows, down.number), np.searchsorted(columns, across.number))
    return x[chosen], y[chosen]


def cheapest(level: Level, hashes: Hashes, frame: Frame) -> tuple[Integers, Integers]:
    """Of a few places within a frame, the cheapest for every hash."""
    x, y = _drawn(hashes, 0, frame)
    best = _price(level, x, y)
    for attempt in range(1, PLACEMENT.draws):
        x_drawn, y_drawn = _drawn(hashes, attempt, frame)
        cost = _price(level, x_drawn, y_drawn)
        better = cost < best
        x, y = np.where(better, x_drawn, x), np.where(better, y_drawn, y)
        best = np.where(better, cost, best)
    return x, y


def inset(frame: Frame, by_x: int, by_y: int) -> Frame:
    """A frame with less room on every side, but with some."""
    by_x = min(by_x, (frame.right - frame.left) // 2)
    by_y = min(by_y, (frame.bottom - frame.top) // 2)
    return Frame(frame.left + by_x, frame.top + by_y, frame.right - by_x, frame.bottom - by_y)


@dataclass(frozen=True)
class _Neighbour:
    """Neighbouring pieces: to the left or right (along x), or above or below; their places."""

    along_x: bool
    step: int
    x: Integers
    y: Integers


def _fitting(
    level: Level,
    hashes: Hashes,
    frame: Frame,
    neighbours: list[_Neighbour],
    width: int,
    height: int,
) -> tuple[Integers, Integers]:
    """Of several places for every hash, the one that continues its neighbours best."""
    best_x, best_y = _drawn(hashes, 0, frame)
    best = np.full(hashes.shape, np.iinfo(np.int64).max)
    for attempt in range(PLACEMENT.fitted):
        x, y = _drawn(hashes, attempt, frame)
        cost = _price(level, x, y).astype(np.int64)
        for other in neighbours:
            cost += _border(level, x, y, other, width, height)
        better = cost < best
        best_x, best_y = np.where(better, x, best_x), np.where(better, y, best_y)
        best = np.where(better, cost, best)
    return best_x, best_y


def _border(
    level: Level, x: Integers, y: Integers, other: _Neighbour, width: int, height: int
) -> Integers:
    """What a border costs: the mean square of how far appearances on both sides are apart."""
    long, short = (height, width) if other.along_x else (width, height)
    step = max(level.spacing, long // PLACEMENT.along)
    along = np.arange(-(long // 2), long - long // 2, step)
    zero = np.zeros_like(along)
    edge = zero + other.step * (short // 2)
    dx, dy = (edge, along) if other.along_x else (along, edge)
    back_x, back_y = (-edge, along) if other.along_x else (along, -edge)

    def seen(x: Integers, y: Integers) -> NDArray[np.int32]:
        x = x.clip(level.frame.left, level.frame.right) >> level.bits
        y = y.clip(level.frame.top, level.frame.bottom) >> level.bits
        return level.appearance[y, x].astype(np.int32)

    here = seen(x[..., None] + dx, y[..., None] + dy)
    there = seen(other.x[..., None] + back_x, other.y[..., None] + back_y)
    squares = np.square(here - there).sum(axis=-1, dtype=np.int64)
    return squares.sum(axis=-1) * 32 // len(along)


def _drawn(hashes: Hashes, attempt: int, frame: Frame) -> tuple[Integers, Integers]:
    """A random place within a frame for every hash."""
    return (
        frame.left + draw(hashes, 2 * attempt, frame.right - frame.left + 1),
        frame.top + draw(hashes, 2 * attempt + 1, frame.bottom - frame.top + 1),
    )


def _price(level: Level, x: Integers, y: Integers) -> NDArray[np.int32]:
    return level.placement_cost[y >> PRICE_BITS, x >> PRICE_BITS]


def _with_neighbours(axis: Axis) -> Integers:
    """Numbers of pieces, sorted, with those that pieces of odd number are fitted to."""
    numbers = np.unique(axis.number)
    odd = numbers[numbers % 2 == 1]
    near = np.concatenate([odd - 1, odd + 1])
    return np.unique(np.concatenate([numbers, near if axis.count is None else near % axis.count]))
