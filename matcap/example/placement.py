"""Placement of a field's patches: what a centre costs, and how near to itself content recurs.

The cost of a centre is the mean placement cost of what its patch shows. Content that two patches
near each other both show is added to the cost of the later one, by its area and nearness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.grids import COST_BITS, Frame
from matcap.example.library import Hashes, draw, hash_places
from matcap.field.turns import Integers

# Placement of patches; docs/notes/field.md.
RULE = 2  # of new files; those without a rule have 1: the cost of centres, and no cost of reuse
_DRAWS = {1: 4, 2: 16}  # random places of which the one of least cost is taken
_FITTED = {1: 24, 2: 48}  # likewise of patches that are fitted to their neighbours
_REUSED = 1 << 24  # cost of a patch that a neighbour at no distance shows as well: four large seams
_NEAR = 512  # texels from which on content may recur at no cost
_COLOURS, _REACH = 3, 2  # patches at a distance of _REACH, in numbers, are of other colours


@dataclass(frozen=True)
class Placement:
    """Costs of the centres of patches."""

    cost: NDArray[np.integer]
    """(H, W) of squares of 2^COST_BITS texels."""
    rule: int
    """Its version, 1 or RULE."""

    @staticmethod
    def of(
        cost: NDArray[np.int32], rule: int, sides: tuple[int, int], joined: Frame | None
    ) -> Placement:
        """Costs of patches of some size.

        Args:
            cost: (H, W) placement cost of squares of texels.
            rule: 1 or RULE.
            sides: width and height of a patch, texels.
            joined: the frame of which opposite borders adjoin, if patches continue across them.
        """
        if rule == 1:
            return Placement(cost, rule)
        columns = None if joined is None else (joined.left, joined.right)
        rows = None if joined is None else (joined.top, joined.bottom)
        across = _means(cost.T, sides[0], columns).T
        return Placement(_means(across, sides[1], rows), rule)

    @property
    def draws(self) -> int:
        """Number of random places of which the one of least cost is taken."""
        return _DRAWS[self.rule]

    @property
    def fitted(self) -> int:
        """Number of random places that are fitted to neighbours."""
        return _FITTED[self.rule]

    def at(self, x: Integers, y: Integers) -> NDArray[np.integer]:
        """Costs of centres x, y."""
        return self.cost[y >> COST_BITS, x >> COST_BITS]

    def cheapest(self, hashes: Hashes, frame: Frame) -> tuple[Integers, Integers]:
        """For every hash, the centre of least cost among random ones within a frame."""
        x, y = drawn(hashes, 0, frame)
        best = self.at(x, y)
        for attempt in range(1, self.draws):
            x_drawn, y_drawn = drawn(hashes, attempt, frame)
            cost = self.at(x_drawn, y_drawn)
            better = cost < best
            x, y = np.where(better, x_drawn, x), np.where(better, y_drawn, y)
            best = np.where(better, cost, best)
        return x, y


def _means(cost: NDArray[np.integer], side: int, joined: tuple[int, int] | None) -> Integers:
    """Means over `side` texels around each row, continued across the borders `joined`."""
    count, rows = max(1, side >> COST_BITS), len(cost)
    around = np.arange(-(count // 2), rows + count - count // 2 - 1)
    first, after = 0, rows
    if joined is not None:
        first, after = -(-joined[0] >> COST_BITS), (joined[1] + 1) >> COST_BITS
    at = around.clip(first, after - 1)
    if joined is not None:
        at = first + (around - first) % (after - first)
    sums = np.cumsum(cost[at], axis=0, dtype=np.int64)
    sums = np.concatenate([np.zeros_like(sums[:1]), sums])
    return np.asarray((sums[count:] - sums[:-count]) // count, np.int64)


def drawn(hashes: Hashes, attempt: int, frame: Frame) -> tuple[Integers, Integers]:
    """A random place within a frame for every hash."""
    return (
        frame.left + draw(hashes, 2 * attempt, frame.right - frame.left + 1),
        frame.top + draw(hashes, 2 * attempt + 1, frame.bottom - frame.top + 1),
    )


def reuse_cost(
    shift: tuple[Integers, Integers],
    in_field: tuple[int, int],
    sides: tuple[int, int],
    wrap: tuple[int, int] | None = None,
) -> Integers:
    """Cost of what two patches both show: _REUSED * area * (1 - distance / _NEAR), by its parts.

    Args:
        shift: x, y of the centre of one less that of the other, in the exemplar, texels.
        in_field: the same in the field. With an equal shift one continues the other, at no cost.
        sides: width and height of a patch.
        wrap: width and height of the exemplar, if patches continue across its borders.
    """
    turns = (0,) if wrap is None else (-1, 0, 1)
    wide, high = wrap or (0, 0)
    total = np.zeros(np.broadcast(*shift).shape, np.int64)
    for turn_y in turns:
        y = shift[1] + turn_y * high
        shown_y = np.maximum(sides[1] - np.abs(y), 0)
        for turn_x in turns:
            x = shift[0] + turn_x * wide
            area = np.maximum(sides[0] - np.abs(x), 0) * shown_y
            distance = np.maximum(np.abs(in_field[0] - x), np.abs(in_field[1] - y))
            near = np.maximum(_NEAR - distance, 0) * (distance > 0)
            total += area * near * (_REUSED // _NEAR) // (sides[0] * sides[1])
    return total


def spread_patches(
    placement: Placement,
    seed: int,
    depth: int,
    frame: Frame,
    axes: tuple[PatchNumbers, PatchNumbers],
) -> tuple[Integers, Integers]:
    """(rows, columns) x, y at the centres of square patches, each of little cost.

    Patches have nine colours by their numbers modulo 3. Each is chosen after those of the colours
    before its own, of which it avoids what those within _REACH show: a patch depends on others
    within eight times that, whatever else has been synthesised.

    Args:
        placement: costs of centres.
        seed, depth: of the field and its coarsest level, for the hashes.
        frame: of the centres.
        axes: numbers of patches along columns and rows.
    """
    across, down = axes
    last = _COLOURS**2 - 1
    columns, rows = across.grown(last * _REACH), down.grown(last * _REACH)
    hashes = hash_places(seed, depth, columns[None, :], rows[:, None])
    x, y = np.zeros((2, *hashes.shape), np.int64)
    for colour in range(last + 1):
        reach = (last - colour) * _REACH
        mine = (
            _of_colour(rows, down.grown(reach), colour // _COLOURS),
            _of_colour(columns, across.grown(reach), colour % _COLOURS),
        )
        if mine[0].size and mine[1].size:
            _choose(placement, hashes, frame, (across, down), mine, colour, (x, y))
    wanted = np.ix_(np.searchsorted(rows, down.numbers), np.searchsorted(columns, across.numbers))
    return x[wanted], y[wanted]


@dataclass(frozen=True)
class PatchNumbers:
    """Numbers of square patches along one axis."""

    numbers: Integers
    """Sorted; modulo `count`."""
    count: int | None
    """Patches in the period, or None."""
    side: int
    """Texels."""

    def grown(self, by: int) -> Integers:
        """Sorted numbers of these patches and of those within a distance."""
        near = np.unique(self.numbers[:, None] + np.arange(-by, by + 1))
        return near if self.count is None else np.unique(near % self.count)

    def shifted(self, numbers: Integers, by: int) -> Integers:
        """Numbers of the patches a distance away."""
        return numbers + by if self.count is None else (numbers + by) % self.count


def _of_colour(numbers: Integers, wanted: Integers, colour: int) -> Integers:
    """Indices of the numbers that are wanted and of a colour along their axis."""
    return np.flatnonzero(np.isin(numbers, wanted) & (numbers % _COLOURS == colour))


def _choose(
    placement: Placement,
    hashes: Hashes,
    frame: Frame,
    axes: tuple[PatchNumbers, PatchNumbers],
    mine: tuple[Integers, Integers],
    colour: int,
    chosen: tuple[Integers, Integers],
) -> None:
    """Choose the patches in rows and columns `mine`, all of one colour, into `chosen`."""
    across, down = axes
    rows, columns = (axis.grown((_COLOURS**2 - 1) * _REACH) for axis in (down, across))
    here, side = np.ix_(*mine), across.side
    tried = [drawn(hashes[here], attempt, frame) for attempt in range(placement.draws)]
    x, y = (np.stack(each) for each in zip(*tried, strict=True))
    cost = placement.at(x, y).astype(np.int64)
    steps = range(-_REACH, _REACH + 1)
    for dy in steps:
        others_y = down.shifted(rows[mine[0]], dy)
        for dx in steps:
            others_x = across.shifted(columns[mine[1]], dx)
            earlier = others_y[:, None] % _COLOURS * _COLOURS + others_x % _COLOURS < colour
            if not earlier.any():
                continue
            at = np.ix_(np.searchsorted(rows, others_y), np.searchsorted(columns, others_x))
            shift = x - chosen[0][at], y - chosen[1][at]
            in_field = -dx * side, -dy * side
            cost += earlier * reuse_cost(shift, in_field, (side, side))
    best = cost.argmin(axis=0)[None]
    for into, each in zip(chosen, (x, y), strict=True):
        into[here] = np.take_along_axis(each, best, axis=0)[0]
