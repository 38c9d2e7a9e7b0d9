"""Synthesis of exemplar coordinates, coarse to fine [lefebvre2005], and their correction."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from matcap.example.candidates import Frame
from matcap.example.index import Level, Lookup, two_phases
from matcap.example.lattice import PhasedLattice, Phases, cells_of
from matcap.example.library import Hashes, Integers, Positions, address, hash_places, loops
from matcap.example.placement import PatchNumbers, Placement, drawn_all, reuse_cost, spread_patches
from matcap.field.plane import Period, Rectangle

# Correction of synthesised coordinates [lefebvre2005] with k-coherence candidates [tong2002].

Places = NDArray[np.int16]  # (rows, columns, 2): x, y of the exemplar

# As in kernel.c. A phase error of a tenth of a turn costs as much as a visible seam.
SUBPASSES = ((0, 0), (1, 1), (0, 1), (1, 0))  # (row, column) parity of the places each one corrects
REACH = 2  # radius in places of the neighbourhood that a sub-pass reads


class _Level(ctypes.Structure):
    _fields_ = (
        ("appearance", ctypes.c_void_p),
        ("placement_cost", ctypes.c_void_p),
        ("similar", ctypes.c_void_p),
        ("phases", ctypes.c_void_p),
        *(
            (name, ctypes.c_int32)
            for name in (
                "columns", "similar_columns", "cost_columns", "bits", "similar_bits",
                "similar_shift", "spacing", "left", "top", "right", "bottom",
            )
        ),
    )  # fmt: skip


def correct(
    places: Places,
    level: Level,
    odd_columns: NDArray[np.bool_],
    odd_rows: NDArray[np.bool_],
    passes: int,
    phases: Phases | None = None,
) -> Places:
    """Replace places by candidates that match their neighbourhood better.

    A place that continues all its neighbours is kept. Otherwise candidates are the continuations of
    the place itself and of its eight neighbours (the neighbour's place minus its offset), and for
    each of these its k-coherence candidate. The cost is the squared difference of appearance at the
    four diagonal neighbours, whose wanted appearance is the mean of what three of their neighbours
    continue to there; plus phase error and placement cost. Of equal costs the first candidate wins,
    continuations first.

    Args:
        places: (rows, columns, 2).
        level: appearance, candidates and costs.
        odd_columns, odd_rows: whether each column and row of the field is odd.
        passes: number of passes, of four sub-passes each.
        phases: (rows, columns, 2) of the ideal lattice, or None.

    Returns:
        (rows - 2 m, columns - 2 m, 2) with m = margin(passes).

    Raises:
        MatcapError: the compiled loops are missing.
    """
    places = np.ascontiguousarray(places).copy()
    phases = None if phases is None else np.ascontiguousarray(phases)
    scratch = np.empty_like(places)
    frame = level.frame
    c_level = _Level(
        level.appearance.ctypes.data, level.placement_cost.ctypes.data, level.similar.ctypes.data,
        None if level.phases is None else level.phases.ctypes.data,
        level.appearance.shape[1], level.similar.shape[1], level.placement_cost.shape[1],
        level.bits, level.similar_bits, level.similar_shift, level.spacing,
        frame.left, frame.top, frame.right, frame.bottom,
    )  # fmt: skip
    rows, columns = places.shape[:2]
    odd_columns, odd_rows = odd_columns.astype(np.uint8), odd_rows.astype(np.uint8)
    loops().matcap_correct(
        ctypes.byref(c_level), address(places), address(scratch), columns, rows,
        address(odd_columns), address(odd_rows), passes,
        None if phases is None else address(phases),
    )  # fmt: skip
    cut = margin(passes)
    return places[cut : rows - cut, cut : columns - cut]


def margin(passes: int) -> int:
    """Places that a correction reads beyond those it returns, on every side."""
    return REACH * len(SUBPASSES) * passes


# Patches of the coarsest level: the grid they are laid on, and the place that each shows
# (docs/notes/field.md).
#
# Larger patches tear long structure less often. They are fitted to their neighbours: of several
# random places the one with the least border mismatch is taken. Patches of even row and even column
# are random; those between two of these along a row or a column are fitted to them; those of odd
# row and odd column are fitted to all four neighbours. A patch thus depends on its neighbours'
# neighbours at most, whatever else has been synthesised.
#
# Patches may begin anywhere in the exemplar and continue across its borders on the opposite side,
# so that all of it is shown equally often: patches inside it show its middle most, and a stain
# there in nearly every patch.

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
) -> Positions:
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
            other_rows = _moved(rows, some_rows, down, step[1])
            there = np.ix_(other_rows, _moved(columns, some_columns, across, step[0]))
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
) -> Positions:
    """For every hash, the random place of least placement cost, border mismatch and reuse."""
    x, y = drawn_all(hashes, placement.fitted, frame)
    cost = placement.at(x, y).astype(np.int64)
    for other in neighbours:
        if 0 in other.step:
            cost += _border_mismatch(level, frame, (x, y), other, *sides)
        if placement.near:
            in_field = -other.step[0] * sides[0], -other.step[1] * sides[1]
            shift = x - other.x, y - other.y
            cost += reuse_cost(shift, in_field, sides, placement.near, frame.size)
    best = cost.argmin(axis=0)[None]
    best_x, best_y = (np.take_along_axis(each, best, axis=0)[0] for each in (x, y))
    return best_x, best_y


def _border_mismatch(
    level: Level, frame: Frame, centre: Positions, other: _Neighbour, width: int, height: int
) -> Integers:
    """32 times the mean squared difference of both sides' appearance along the common border."""
    along_x = other.step[1] == 0
    long, short = (height, width) if along_x else (width, height)
    along = np.arange(-(long // 2), long - long // 2, max(level.spacing, long // _ALONG))
    edge = np.zeros_like(along) + sum(other.step) * (short // 2)
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


# Synthesis of exemplar coordinates, coarse to fine [lefebvre2005].
#
# A place is the exemplar's texel (x, y) that a texel of the field shows. The coarsest level is laid
# from patches at random places. Each finer level upsamples the places and corrects them. Random
# numbers are hashes of seed and position, and a correction reads a fixed neighbourhood, so that a
# rectangle with a margin on every level has the same bits whoever computes it.
#
# Unlike Lefebvre and Hoppe, no level is jittered: that would break up structure of more than some
# ten texels, and does not reduce repetition (docs/notes/field.md).

_PASSES = (1, 2)  # of correction at the finest level, and at every coarser one


def coordinates(
    lookup: Lookup, seed: int, wanted: Mapping[int, Rectangle], period: Period | None
) -> dict[int, Places]:
    """Synthesise places of some levels.

    Args:
        seed: in [-2^63, 2^63).
        wanted: by level the area to return, in steps of 2^level texels.
        period: of the field, multiples of 2^(levels - 1) texels, or None.

    Returns:
        By level, (height, width, 2) int16 places.
    """
    finest, count = min(wanted), len(lookup.levels)
    # Areas of each level after and before correction, which cuts a margin off.
    areas: dict[int, Rectangle] = {}
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
            places = initial_places(lookup, seed, columns, rows, period)
        else:
            places = _refine(places, areas[depth + 1], level, area)
        phases = _ideal_phases(lookup, seed, depth, columns, rows, period)
        odd_columns, odd_rows = columns % 2 == 1, rows % 2 == 1
        places = correct(places, level, odd_columns, odd_rows, _passes(depth), phases)
        if depth in wanted:
            by_depth[depth] = places[wanted[depth].within(areas[depth])]
    return by_depth


def _passes(depth: int) -> int:
    return _PASSES[min(depth, 1)]


def _wrapped(area: Rectangle, depth: int, period: Period | None) -> Positions:
    """Columns and rows of an area, modulo the period."""
    columns = np.arange(area.x, area.x + area.width)
    rows = np.arange(area.y, area.y + area.height)
    along_x, along_y = period or (None, None)
    return (
        columns if along_x is None else columns % (along_x >> depth),
        rows if along_y is None else rows % (along_y >> depth),
    )


def initial_places(
    lookup: Lookup, seed: int, columns: Integers, rows: Integers, period: Period | None
) -> Places:
    """(rows, columns, 2) places of the coarsest level, before correction: patches at random places.

    With a lattice, patches are in phase with it. Columns and rows need not be contiguous.
    """
    depth, level = len(lookup.levels) - 1, lookup.levels[-1]
    x, y = columns << depth, rows << depth
    if lookup.lattice is not None:
        place_x, place_y = _ordered(lookup, lookup.lattice, seed, x, y, period)
    elif lookup.sizes.loose:
        place_x, place_y = _loose(lookup, seed, x, y, period)
    else:
        along_x, along_y = period or (None, None)
        frame, sizes = lookup.joined, lookup.sizes
        wide, high = frame.size
        if sizes.whole:
            axes = Axis.of(x, wide, along_x).alike(), Axis.of(y, high, along_y).alike()
        else:
            wide, high = min(sizes.width, wide), min(sizes.height, high)
            axes = Axis.of(x, wide, along_x), Axis.of(y, high, along_y)
        place_x, place_y = lay_patches(level, lookup.placement, depth, seed, frame, axes)
    return _clamped(np.stack([place_x, place_y], axis=-1), level.frame)


def _loose(lookup: Lookup, seed: int, x: Integers, y: Integers, period: Period | None) -> Positions:
    """Places x, y of patches that are not fitted to their neighbours."""
    depth, level, placement = len(lookup.levels) - 1, lookup.levels[-1], lookup.placement
    wide, high = lookup.sizes.width, lookup.sizes.height
    # The frame is inset so that a patch around its centre stays inside.
    within = inset(level.frame, wide // 2, high // 2)
    if placement.rule == 1:
        hashes = hash_places(seed, depth, x // wide, (y // high)[:, None])
        best_x, best_y = placement.cheapest(hashes, within)
    else:
        columns, rows = (
            PatchNumbers(np.unique(at // side), along and -(-along // side), side)
            for at, along, side in zip((x, y), period or (None, None), (wide, high), strict=True)
        )
        centres = spread_patches(placement, seed, depth, within, (columns, rows))
        down = np.searchsorted(rows.numbers, y // high)
        shown = np.ix_(down, np.searchsorted(columns.numbers, x // wide))
        best_x, best_y = (at[shown] for at in centres)
    return best_x + x % wide - wide // 2, best_y + (y % high - high // 2)[:, None]


def _ordered(
    lookup: Lookup,
    lattice: PhasedLattice,
    seed: int,
    x: Integers,
    y: Integers,
    period: Period | None,
) -> Positions:
    """Places x, y of lattice patches, in phase with the field's lattice."""
    depth, level = len(lookup.levels) - 1, lookup.levels[-1]
    together = lookup.sizes.cells
    wide = high = round(lattice.patch_width(together))
    if not lookup.sizes.loose:
        wide, high = (round(side) for side in lattice.patch_extent(together))
    cells = cells_of(lattice, seed, x, y, period or (None, None), together)
    hashes = hash_places(seed, depth, cells.column, cells.row)
    within = inset(level.frame, wide // 2, high // 2)
    best_x, best_y = lookup.placement.cheapest(hashes, within)
    centres = cells.middle_x, cells.middle_y
    best_x, best_y = _in_phase(lattice, seed, (best_x, best_y), centres, period)
    places = best_x + x - cells.middle_x, best_y + y[:, None] - cells.middle_y
    # Where the exemplar's lattice is bent, texels off the centre are brought into phase as well.
    if not lattice.is_bent:
        return places
    return _in_phase(lattice, seed, places, (x[None, :], y[:, None]), period)


def _in_phase(
    lattice: PhasedLattice, seed: int, places: Positions, texels: Positions, period: Period | None
) -> Positions:
    """Move places by less than a period, so that their phases are those of texels of the field."""
    return lattice.in_phase(lattice.ideal_phases(seed, *texels, period or (None, None)), *places)


def _ideal_phases(
    lookup: Lookup, seed: int, depth: int, columns: Integers, rows: Integers, period: Period | None
) -> Phases | None:
    """(rows, columns, 2) phases of the ideal lattice, or None where the level does not use them."""
    if lookup.lattice is None or lookup.levels[depth].phases is None:
        return None
    phases = lookup.lattice.ideal_phases(
        seed, (columns << depth)[None, :], (rows << depth)[:, None], period or (None, None)
    )
    return two_phases(phases)


def _refine(coarse: Places, given: Rectangle, level: Level, area: Rectangle) -> Places:
    """Upsample places: each coarse one gives four at the next level.

    Args:
        coarse: places of the area `given`.
        given: in steps of the coarser level.
        area: to return, in steps of the finer level.
    """
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
