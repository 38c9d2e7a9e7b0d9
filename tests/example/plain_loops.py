"""The loops of kernel.c, plainly: in NumPy and to the same bits."""

import numpy as np
from numpy.typing import NDArray

from matcap.example.appearance import DIMENSIONS, LARGEST, Appearance, Basis, offsets, padded
from matcap.example.correction import REACH, SUBPASSES, Places, margin
from matcap.example.features import PLANES, FeatureMap
from matcap.example.grids import PRICE_BITS
from matcap.example.lookup import Level
from matcap.example.order import Phases

DIAGONALS = ((-1, -1), (-1, 1), (1, -1), (1, 1))
_AROUND = ((0, 0), (-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
PHASE_SHIFT = 2
SIMILAR_TIMES = 2
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
    cost = np.zeros(places.shape[:2], np.int32)
    for (y, x), target in zip(DIAGONALS, wanted, strict=True):
        step = np.array([x * level.spacing, y * level.spacing], np.int32)
        cost += np.square(3 * _looked_up(level, safe + step) - target).sum(-1, dtype=np.int32)
    if similar:
        cost *= SIMILAR_TIMES
    at = safe[..., 1] >> level.bits, safe[..., 0] >> level.bits
    cost += level.price[safe[..., 1] >> PRICE_BITS, safe[..., 0] >> PRICE_BITS]
    if ordered is not None and level.phases is not None:
        # Wraps, as turns do.
        apart = (level.phases[at] - ordered).astype(np.int32)
        cost += np.square(apart >> PHASE_SHIFT).sum(-1, dtype=np.int32)
    return np.where(inside, cost, _NEVER)
