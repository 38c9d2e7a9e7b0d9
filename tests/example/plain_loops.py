"""The loops of kernel.c, plainly: in NumPy and to the same bits."""

import numpy as np
from numpy.typing import NDArray

from matcap.example.blend import CHANNELS, NODES
from matcap.example.candidates import (
    COST_BITS,
    DIMENSIONS,
    LARGEST,
    PLANES,
    Appearance,
    Basis,
    FeatureMap,
    offsets,
    padded,
)
from matcap.example.coordinates import REACH, SUBPASSES, Places, margin
from matcap.example.index import Level
from matcap.example.lattice import Phases

DIAGONALS = ((-1, -1), (-1, 1), (1, -1), (1, 1))
_AROUND = ((0, 0), (-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
PHASE_SHIFT = 2
_NEVER = np.int32(2**31 - 1)
_ROWS = 32  # projected at a time: they stay in the cache


def project(features: FeatureMap, basis: Basis) -> Appearance:
    """(H, W, DIMENSIONS) of (PLANES, H, W) features, which continue mirrored at the borders."""
    rows, columns = features.shape[1:]
    around = padded(features, basis).astype(np.float32)
    weights = basis.weights.astype(np.float32).reshape(DIMENSIONS, -1, PLANES)
    found = np.empty((rows, columns, DIMENSIONS), np.int16)
    for top in range(0, rows, _ROWS):
        some = min(_ROWS, rows - top)
        sums = np.zeros((DIMENSIONS, some * columns), np.float32)
        for index, (y, x) in enumerate(offsets(basis.step)):
            part = around[:, top + y : top + y + some, x : x + columns]
            sums += weights[:, index] @ part.reshape(PLANES, -1)
        shifted = sums.astype(np.int32) >> basis.shift
        np.clip(shifted, -LARGEST, LARGEST, out=shifted)
        found[top : top + some] = shifted.T.reshape(some, columns, DIMENSIONS)
    return found


def correct(
    places: Places,
    level: Level,
    odd_columns: NDArray[np.bool_],
    odd_rows: NDArray[np.bool_],
    passes: int,
    phases: Phases | None = None,
) -> Places:
    """As correction.correct."""
    assert (phases is None) == (level.phases is None)
    places = places.copy()
    for row_parity, column_parity in SUBPASSES * passes:
        rows, columns = (
            np.flatnonzero(odd[REACH:-REACH] == parity) + REACH
            for odd, parity in ((odd_rows, row_parity), (odd_columns, column_parity))
        )
        before = places.copy()
        places[np.ix_(rows, columns)] = _corrected(before, level, rows, columns, phases)
    cut = margin(passes)
    return places[cut : places.shape[0] - cut, cut : places.shape[1] - cut]


def _corrected(
    places: Places,
    level: Level,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    phases: Phases | None,
) -> Places:
    step = level.spacing

    def continued(y: int, x: int) -> NDArray[np.int32]:
        """Where the neighbour at (y, x) is continued to here."""
        found = places[np.ix_(rows + y, columns + x)].astype(np.int32)
        return found - np.array([x * step, y * step], np.int32)

    own = continued(0, 0)
    settled = np.ones(own.shape[:2], bool)
    for y, x in _AROUND[1:]:
        settled &= (continued(y, x) == own).all(-1)
    wanted = []  # three times the appearance of each diagonal neighbour
    for y, x in DIAGONALS:
        total = np.zeros((*own.shape[:2], level.appearance.shape[2]), np.int32)
        for further_y, further_x in ((0, 0), (y, 0), (0, x)):
            from_there = continued(y + further_y, x + further_x)
            total += _looked_up(level, from_there + np.array([x * step, y * step], np.int32))
        wanted.append(total)
    ordered = None if phases is None else phases[np.ix_(rows, columns)]
    best, best_cost = own, np.full(own.shape[:2], _NEVER)
    for similar in (False, True):
        for y, x in _AROUND:
            candidate = continued(y, x)
            if similar:
                candidate = _similar(level, candidate)
            cost = _cost(level, candidate, wanted, ordered, similar=similar)
            better = cost < best_cost
            best = np.where(better[..., None], candidate, best)
            best_cost = np.where(better, cost, best_cost)
    return np.where(settled[..., None], own, best).astype(np.int16)


def _looked_up(level: Level, places: NDArray[np.int32]) -> NDArray[np.int32]:
    return level.appearance[places[..., 1] >> level.bits, places[..., 0] >> level.bits].astype(
        np.int32
    )


def _similar(level: Level, places: NDArray[np.int32]) -> NDArray[np.int32]:
    """The similar places; of a place outside the frame, one outside."""
    bits = level.similar_bits
    inside = _inside(level, places)
    rows = np.where(inside, places[..., 1], 0) >> bits
    columns = np.where(inside, places[..., 0], 0) >> bits
    found = level.similar[rows, columns] + (places & ((1 << bits) - 1))
    return np.where(inside[..., None], found, -1)


def _inside(level: Level, places: NDArray[np.int32]) -> NDArray[np.bool_]:
    x, y, frame = places[..., 0], places[..., 1], level.frame
    return (x >= frame.left) & (x <= frame.right) & (y >= frame.top) & (y <= frame.bottom)


def _cost(
    level: Level,
    places: NDArray[np.int32],
    wanted: list[NDArray[np.int32]],
    ordered: Phases | None,
    *,
    similar: bool,
) -> NDArray[np.int32]:
    inside = _inside(level, places)
    safe = np.where(inside[..., None], places, [level.frame.left, level.frame.top])
    cost = np.zeros(places.shape[:2], np.int64)
    for (y, x), target in zip(DIAGONALS, wanted, strict=True):
        step = np.array([x * level.spacing, y * level.spacing], np.int32)
        cost += np.square(3 * _looked_up(level, safe + step) - target).sum(-1, dtype=np.int64)
    if similar:
        cost <<= level.similar_shift
    at = safe[..., 1] >> level.bits, safe[..., 0] >> level.bits
    cost += level.placement_cost[safe[..., 1] >> COST_BITS, safe[..., 0] >> COST_BITS]
    if ordered is not None and level.phases is not None:
        # Wraps, as turns do.
        apart = (level.phases[at] - ordered).astype(np.int32)
        cost += np.square(apart >> PHASE_SHIFT).sum(-1, dtype=np.int32)
    return np.where(inside, cost, _NEVER)


def smooth(values):
    """As matcap_smooth: (H, W, CHANNELS) float32 smoothed along both axes, borders repeated."""
    taps = [np.float32(tap / 256.0) for tap in (70, 56, 28, 8, 1)]
    for axis in (1, 0):
        count = values.shape[axis]
        at = np.arange(count)
        found = values * taps[0]
        for apart, tap in enumerate(taps[1:], start=1):
            before, after = (
                values.take((at + way * apart).clip(0, count - 1), axis) for way in (-1, 1)
            )
            found = found + (before + after) * tap
        values = found
    return values


def blended(shown, area, own, votes):
    """As blend.blended."""
    side = 1 << shown.bits
    y, x = np.mgrid[: area.height, : area.width]
    at_x, at_y = x + (area.x & (side - 1)), y + (area.y & (side - 1))
    places = own[at_y >> shown.bits, at_x >> shown.bits].astype(np.int64) << shown.bits
    places += np.stack([at_x & (side - 1), at_y & (side - 1)], axis=-1)
    total = np.zeros((area.height, area.width, CHANNELS), np.float32)
    keeps = np.arange(CHANNELS) != len(shown.planes) - 1
    for band, votes_of, alike in zip(shown.bands, votes, shown.correlations, strict=True):
        mine = _band_at(band.values, band.bits + shown.bits + 1, side - 1, places)
        one, gain = _voted(band, votes_of, band.bits + shown.bits + 1, side - 1, np.float32(alike))
        kept = np.float32(1.0) + (gain - np.float32(1.0))[..., None] * keeps.astype(np.float32)
        total += band.scale * (kept * one - mine)
    found = np.stack([plane[places[..., 1], places[..., 0]] for plane in shown.planes])
    logs = len(shown.planes) - 2
    found[:logs] *= _power(np.moveaxis(total, -1, 0)[:logs])
    found[logs:] += np.moveaxis(total, -1, 0)[logs : logs + 2]
    found[:-1] = found[:-1].clip(0.0, 1.0)
    return found


def _voted(band, votes_of, shift, half, alike):
    """(H, W, CHANNELS) the mean of a band's votes, in its numbers; (H, W) what it is to gain."""
    nodes, predicted = votes_of
    rows, columns = len(nodes.down.first), len(nodes.across.first)
    here = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    grid = [(r, c) for r in range(NODES) for c in range(NODES)]
    votes = [
        predicted[nodes.down.first[:, None] + r, nodes.across.first[None, :] + c] for r, c in grid
    ]
    total = np.zeros((rows, columns, CHANNELS), np.float32)
    squares = np.zeros((rows, columns), np.float32)
    kinds = np.zeros((rows, columns), int)
    for k, vote in enumerate(votes):
        fresh = ~np.any([(vote == other).all(-1) for other in votes[:k]], axis=0) if k else True
        across = np.zeros((NODES, rows, columns), np.float32)
        for (r, c), other in zip(grid, votes, strict=True):
            alike_votes = (vote == other).all(-1)
            across[c] += np.where(alike_votes, nodes.down.weights[:, r, None], np.float32(0.0))
        weight = across[0] * nodes.across.weights[:, 0]
        weight = weight + across[1] * nodes.across.weights[:, 1]
        weight = weight + across[2] * nodes.across.weights[:, 2]
        weight = np.where(fresh, weight, np.float32(0.0))
        squares = squares + weight * weight
        total = total + weight[..., None] * _band_at(band.values, shift, half, here + vote)
        kinds += fresh
    gain = np.float32(1.0) / np.sqrt(alike + (np.float32(1.0) - alike) * squares)
    agreed = kinds == 1
    one = _band_at(band.values, shift, half, here + votes[0])
    return np.where(agreed[..., None], one, total), np.where(agreed, np.float32(1.0), gain)


def _band_at(values, shift, half, places):
    """A band between the texels of its grid, at (..., 2) places x, y of the exemplar."""
    unit = np.float32(1.0 / (1 << shift))
    ends = np.array(values.shape[1::-1]) - 1
    doubled = (2 * places - half).clip(0, ends << shift)
    first = doubled >> shift
    after = np.minimum(first + 1, ends)
    part = (doubled & ((1 << shift) - 1)).astype(np.float32) * unit

    def of(x, y):
        return values[y[..., 1], x[..., 0]].astype(np.float32)

    across, down = part[..., :1], part[..., 1:]
    upper = of(first, first) + (of(after, first) - of(first, first)) * across
    lower = of(first, after) + (of(after, after) - of(first, after)) * across
    return upper + (lower - upper) * down


def _power(x):
    """2^x as kernel.c has it, in float32."""
    x = x.clip(-30.0, 30.0)
    whole = (x + np.float32(64.5)).astype(np.int32) - 64
    f = (x - whole.astype(np.float32)) * np.float32(0.69314718)
    found = np.float32(1.0 / 720.0)
    for divisor in (120.0, 24.0, 6.0, 2.0, 1.0, 1.0):
        found = np.float32(1.0) / np.float32(divisor) + f * found
    return found * np.exp2(whole.astype(np.float32))


def discontinuity(donor, shown, texels, corners, most):
    """Sums over features of mean squared differences, and of variances: (2, blocks)."""
    count = np.float32(len(texels))
    copied = donor.reshape(-1, donor.shape[-1])[texels[:, None] + corners]
    difference = np.minimum(np.square(copied - shown[:, None]), np.float32(most))
    # Numbers are added one after the other only along an outer axis.
    difference, total, squares = (
        each.sum(axis=0) / count for each in (difference, copied, np.square(copied))
    )
    variance = squares - total * total
    return np.stack([np.cumsum(each, axis=1)[:, -1] for each in (difference, variance)])
