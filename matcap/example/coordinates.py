"""Which place of the exemplar every texel of the endless field shows.

Coarse to fine: the coarsest level begins with pieces of the exemplar at random; each finer one
takes over, and corrects (correction.py). What is random is a hash of seed and place, and a
correction looks a fixed number of places around itself: so a rectangle needs some more places
around it at every level, and then is a part of the endless whole, to the bit.

Lefebvre and Hoppe (2005) also move places at random on every level. That breaks up what is longer
than some ten texels, and repetition is not what it mends (docs/notes/field.md).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from matcap.example.correction import Places, correct, margin
from matcap.example.grids import Frame
from matcap.example.hashing import hash_places
from matcap.example.lookup import Level, Lookup, two_phases
from matcap.example.order import Cells, Integers, Order, Phases, cells_of
from matcap.example.pieces import Axis, cheapest, inset, laid
from matcap.example.tuned import PLACEMENT
from matcap.field.plane import Period, Rectangle


def coordinates(
    lookup: Lookup,
    seed: int,
    wanted: Mapping[int, Rectangle],
    period: Period | None,
) -> dict[int, Places]:
    """Places of some levels, found no finer than the finest of them.

    Args:
        lookup: of the exemplar.
        seed: in [-2^63, 2^63).
        wanted: an area of every level, in steps of it, 2^level texels.
        period: that the field repeats in, multiples of 2^(levels - 1) texels.

    Returns:
        (height, width, 2) int16 places of every area.
    """
    finest, count = min(wanted), len(lookup.levels)
    areas: dict[int, Rectangle] = {}  # what each level gives, and what it is begun with
    begun: dict[int, Rectangle] = {}
    for depth in range(finest, count):
        areas[depth] = begun[depth - 1].coarser(1) if depth > finest else wanted[depth]
        if depth in wanted:
            areas[depth] = areas[depth].united(wanted[depth])
        begun[depth] = areas[depth].grown(margin(_passes(depth)))
    places: Places | None = None
    by_depth = {}
    for depth in reversed(range(finest, count)):
        level, area = lookup.levels[depth], begun[depth]
        columns, rows = _wrapped(area, depth, period)
        if places is None:
            places = begin(lookup, seed, columns, rows, period)
        else:
            places = _refine(places, areas[depth + 1], level, area)
        phases = _wanted(lookup, seed, depth, columns, rows, period)
        odd_columns, odd_rows = columns % 2 == 1, rows % 2 == 1
        places = correct(places, level, odd_columns, odd_rows, _passes(depth), phases)
        if depth in wanted:
            by_depth[depth] = places[wanted[depth].within(areas[depth])]
    return by_depth


def _passes(depth: int) -> int:
    return PLACEMENT.passes[min(depth, 1)]


def _wrapped(area: Rectangle, depth: int, period: Period | None) -> tuple[Integers, Integers]:
    """Columns and rows of an area within the first period."""
    columns = np.arange(area.x, area.x + area.width)
    rows = np.arange(area.y, area.y + area.height)
    along_x, along_y = period or (None, None)
    return (
        columns if along_x is None else columns % (along_x >> depth),
        rows if along_y is None else rows % (along_y >> depth),
    )


def begin(
    lookup: Lookup, seed: int, columns: Integers, rows: Integers, period: Period | None
) -> Places:
    """Pieces of the exemplar at random places, for columns and rows of the coarsest level.

    In phase with the order there is. Every place stands for itself: columns and rows need not be
    neighbours.
    """
    depth, level = len(lookup.levels) - 1, lookup.levels[-1]
    x, y = columns << depth, rows << depth
    if lookup.order is not None:
        best_x, best_y, offset_x, offset_y = _ordered(lookup, lookup.order, seed, x, y, period)
    elif lookup.sizes.loose:
        side = lookup.sizes.width
        # Middles of pieces, from which places are counted.
        offset_x, offset_y = x % side - side // 2, (y % side - side // 2)[:, None]
        hashes = hash_places(seed, depth, x // side, (y // side)[:, None])
        # As much around the middle of a piece as it is wide.
        best_x, best_y = cheapest(level, hashes, inset(level.frame, side // 2, side // 2))
    else:
        along_x, along_y = period or (None, None)
        across, down = (
            Axis.of(x, lookup.sizes.width, along_x),
            Axis.of(y, lookup.sizes.height, along_y),
        )
        best_x, best_y = laid(level, depth, seed, across, down)
        offset_x, offset_y = across.offset, down.offset[:, None]
    places = np.stack(np.broadcast_arrays(best_x + offset_x, best_y + offset_y), axis=-1)
    return _clamped(places, level.frame)


def _ordered(
    lookup: Lookup, order: Order, seed: int, x: Integers, y: Integers, period: Period | None
) -> tuple[Integers, Integers, Integers, Integers]:
    """Places of cells' middles in phase with the order, and how far texels are from those."""
    depth, level = len(lookup.levels) - 1, lookup.levels[-1]
    together = lookup.sizes.cells
    wide = high = round(order.piece(together))
    if not lookup.sizes.loose:
        wide, high = (round(side) for side in order.extent(together))
    cells = cells_of(order, seed, x, y, period or (None, None), together)
    hashes = hash_places(seed, depth, cells.column, cells.row)
    best_x, best_y = cheapest(level, hashes, inset(level.frame, wide // 2, high // 2))
    best_x, best_y = _in_phase(order, seed, best_x, best_y, cells, period)
    return best_x, best_y, x - cells.middle_x, y[:, None] - cells.middle_y


def _in_phase(
    order: Order, seed: int, x: Integers, y: Integers, cells: Cells, period: Period | None
) -> tuple[Integers, Integers]:
    """Places of the exemplar moved by less than a period, in phase with the middles of cells."""
    wanted = order.wanted(seed, cells.middle_x, cells.middle_y, period or (None, None))
    turns = order.periods()
    for _ in range(2):  # the second time for what the lattice bends on the way
        phase_error = (wanted - order.phases(x, y)).astype(np.int64)
        x = x + ((phase_error @ turns[0] + (1 << 23)) >> 24)
        y = y + ((phase_error @ turns[1] + (1 << 23)) >> 24)
    return x, y


def _wanted(
    lookup: Lookup,
    seed: int,
    depth: int,
    columns: Integers,
    rows: Integers,
    period: Period | None,
) -> Phases | None:
    """(rows, columns, 2) phases that places of a level are to have."""
    if lookup.order is None or lookup.levels[depth].phases is None:
        return None
    phases = lookup.order.wanted(
        seed, (columns << depth)[None, :], (rows << depth)[:, None], period or (None, None)
    )
    return two_phases(phases)


def _refine(coarse: Places, given: Rectangle, level: Level, area: Rectangle) -> Places:
    """Each place's four finer ones, in an area, of the places of an area that were given."""
    left, top = area.x - 2 * given.x, area.y - 2 * given.y
    fine = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)
    fine = fine[top : top + area.height, left : left + area.width].copy()
    step, first_x, first_y = level.spacing, area.x & 1, area.y & 1
    fine[:, (1 - first_x) :: 2, 0] += np.int16(step)
    fine[(1 - first_y) :: 2, :, 1] += np.int16(step)
    return _clamped(fine, level.frame)


def _clamped(places: NDArray[np.integer], frame: Frame) -> Places:
    least = np.array([frame.left, frame.top], places.dtype)
    most = np.array([frame.right, frame.bottom], places.dtype)
    return places.clip(least, most).astype(np.int16, copy=False)
