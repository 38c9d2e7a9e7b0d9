"""Which place of the exemplar every texel of the endless field shows.

Coarse to fine: the coarsest level begins with pieces of the exemplar at random; each finer one
takes over, moves a little at random, and corrects (plain.py). What is random is a hash of seed,
level and place, and a correction looks a fixed number of places around itself: so a rectangle
needs some more places around it at every level, and then is a part of the endless whole, to the
bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.model.example.hashing import draw, hash_places
from matcap.model.example.index import Frame, Index, Level
from matcap.model.example.order import Order, Period, Phases
from matcap.model.example.plain import Places, margin

Correct = Callable[
    [Places, Level, NDArray[np.bool_], NDArray[np.bool_], int, Phases | None], Places
]

_PIECE = 2  # bits: places along a side of the pieces that the coarsest level begins with
_DRAWS = 4  # pieces that each is the cheapest of
_JITTER = {0: 0, 1: 0, 2: 0}  # 16ths of a step by which places are moved, by level
_JITTER_COARSE = 8
_PASSES = 2


@dataclass(frozen=True)
class Area:
    """Columns x to x + width and rows y to y + height of a level's places."""

    x: int
    y: int
    width: int
    height: int

    def grown(self, by: int) -> Area:
        """With so many more on every side."""
        return Area(self.x - by, self.y - by, self.width + 2 * by, self.height + 2 * by)

    def halved(self) -> Area:
        """Of the next coarser level: all that these places are taken from."""
        x, y = self.x >> 1, self.y >> 1
        right, bottom = (self.x + self.width + 1) >> 1, (self.y + self.height + 1) >> 1
        return Area(x, y, right - x, bottom - y)


def coordinates(
    index: Index,
    seed: int,
    area: Area,
    period: Period | None,
    correct: Correct,
) -> Places:
    """(height, width, 2) int16 places of an area of the field.

    Args:
        index: of the exemplar.
        seed: in [-2^63, 2^63).
        area: in texels.
        period: that the field repeats in, multiples of 2^(levels - 1).
        correct: plain.correct, or the compiled one.
    """
    areas = [area.grown(margin(_PASSES))]
    for _ in index.levels[1:]:
        areas.append(areas[-1].halved().grown(margin(_PASSES)))
    places: Places | None = None
    for depth in reversed(range(len(index.levels))):
        level, wanted = index.levels[depth], areas[depth]
        columns, rows = _wrapped(wanted, depth, period)
        if places is None:
            places = _begin(index, seed, columns, rows, period)
        else:
            places = _refine(places, level, seed, depth, wanted, columns, rows)
        phases = _wanted(index, seed, depth, columns, rows, period)
        odd_columns, odd_rows = columns % 2 == 1, rows % 2 == 1
        places = correct(places, level, odd_columns, odd_rows, _PASSES, phases)
    assert places is not None
    return places


def _wrapped(
    area: Area, depth: int, period: Period | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of an area within the first period."""
    columns = np.arange(area.x, area.x + area.width)
    rows = np.arange(area.y, area.y + area.height)
    along_x, along_y = period or (None, None)
    return (
        columns if along_x is None else columns % (along_x >> depth),
        rows if along_y is None else rows % (along_y >> depth),
    )


def _begin(
    index: Index,
    seed: int,
    columns: NDArray[np.int64],
    rows: NDArray[np.int64],
    period: Period | None,
) -> Places:
    """Pieces of the exemplar at random places, in phase with the order there is."""
    depth, level = len(index.levels) - 1, index.levels[-1]
    side, frame = 1 << _PIECE, level.frame
    reach = (side - 1) * level.spacing
    pieces_x, pieces_y = columns >> _PIECE, rows >> _PIECE
    # Every piece is drawn once.
    some_x, to_x = np.unique(pieces_x, return_inverse=True)
    some_y, to_y = np.unique(pieces_y, return_inverse=True)
    hashes = hash_places(seed, depth, some_x, some_y)
    wide = max(1, frame.right - reach - frame.left + 1)
    high = max(1, frame.bottom - reach - frame.top + 1)
    best_x = best_y = best = None
    for attempt in range(_DRAWS):
        x = frame.left + draw(hashes, 2 * attempt, wide)
        y = frame.top + draw(hashes, 2 * attempt + 1, high)
        middle = reach // 2
        cost = level.price[(y + middle) >> level.bits, (x + middle) >> level.bits]
        if best is None:
            best_x, best_y, best = x, y, cost
        else:
            better = cost < best
            best_x, best_y = np.where(better, x, best_x), np.where(better, y, best_y)
            best = np.where(better, cost, best)
    if index.order is not None:
        best_x, best_y = _in_phase(index.order, seed, level, best_x, best_y, some_x, some_y, period)
    x = best_x[to_y[:, None], to_x] + (columns & (side - 1)) * level.spacing
    y = best_y[to_y[:, None], to_x] + (rows & (side - 1))[:, None] * level.spacing
    return _clamped(np.stack([x, y], axis=-1), frame)


def _wanted(
    index: Index,
    seed: int,
    depth: int,
    columns: NDArray[np.int64],
    rows: NDArray[np.int64],
    period: Period | None,
) -> Phases | None:
    """(rows, columns, 2) phases that places of a level are to have."""
    if index.order is None or index.levels[depth].phases is None:
        return None
    found = index.order.wanted(
        seed, (columns << depth)[None, :], (rows << depth)[:, None], period or (None, None)
    )
    return np.pad(found, ((0, 0), (0, 0), (0, 2 - found.shape[2])))


def _in_phase(
    order: Order,
    seed: int,
    level: Level,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    pieces_x: NDArray[np.int64],
    pieces_y: NDArray[np.int64],
    period: Period | None,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pieces moved by less than a period, so that their middles are in phase."""
    piece = level.spacing << _PIECE
    middle = piece // 2
    wanted = order.wanted(
        seed,
        (pieces_x * piece + middle)[None, :],
        (pieces_y * piece + middle)[:, None],
        period or (None, None),
    )
    turns = order.periods()
    for _ in range(2):  # the second time for what the lattice bends on the way
        found = order.phases(x + middle, y + middle)
        apart = (wanted - found).astype(np.int64)
        x = x + ((apart @ turns[0] + (1 << 23)) >> 24)
        y = y + ((apart @ turns[1] + (1 << 23)) >> 24)
    return x, y


def _refine(
    coarse: Places,
    level: Level,
    seed: int,
    depth: int,
    area: Area,
    columns: NDArray[np.int64],
    rows: NDArray[np.int64],
) -> Places:
    """Each place's four finer ones, moved a little at random where the level is coarse."""
    first_x, first_y = area.x & 1, area.y & 1
    fine = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)
    fine = fine[first_y : first_y + area.height, first_x : first_x + area.width].copy()
    step = level.spacing
    fine[:, (1 - first_x) :: 2, 0] += np.int16(step)
    fine[(1 - first_y) :: 2, :, 1] += np.int16(step)
    strength = _JITTER.get(depth, _JITTER_COARSE) * step // 16
    if strength:
        hashes = hash_places(seed, depth, columns, rows)
        for axis in (0, 1):
            fine[..., axis] += (draw(hashes, axis, 2 * strength + 1) - strength).astype(np.int16)
    return _clamped(fine, level.frame)


def _clamped(places: NDArray[np.integer], frame: Frame) -> Places:
    least = np.array([frame.left, frame.top])
    most = np.array([frame.right, frame.bottom])
    return places.clip(least, most).astype(np.int16)
