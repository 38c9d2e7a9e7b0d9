"""For every place of an exemplar one that looks most like it elsewhere (k-coherence).

Nearest neighbours among appearances, found by all places at once: what is alike lies side by side
along any line through the space of appearances, so each place tries its neighbours along a few
random lines, and then, as in PatchMatch [barnes2009], what its neighbours found, moved
along. Lines are hashes, distances are integers, so that the same appearances have the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.appearance import Appearance
from matcap.example.hashing import draw, hash_places
from matcap.example.tuned import SIMILAR

_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
_SEED = 0x51417


@dataclass(frozen=True)
class Similar:
    """Places on a grid, in its own texels."""

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    """(H, W) int32."""
    distances: NDArray[np.int32]
    """(H, W) int32 squared, of the appearances."""


def find_similar(
    appearance: Appearance,
    gap: int,
    allowed: tuple[slice, slice],
    start: tuple[NDArray[np.int32], NDArray[np.int32]] | None = None,
) -> Similar:
    """k-coherence candidate of each grid place: the most similar place at least `gap` texels off.

    Args:
        appearance: (H, W, DIMENSIONS).
        gap: texels, the larger of the offsets along x and y.
        allowed: rows and columns that a place may be in.
        start: rows and columns to begin with, as of a coarser grid.
    """
    high, wide = appearance.shape[:2]
    own_rows, own_columns = np.mgrid[0:high, 0:wide].astype(np.int32)
    top, bottom = allowed[0].start, allowed[0].stop
    left, right = allowed[1].start, allowed[1].stop
    flat = appearance.reshape(-1, appearance.shape[2])

    def distance(rows: NDArray[np.int32], columns: NDArray[np.int32]) -> NDArray[np.int32]:
        other = flat[(rows * wide + columns).ravel()].reshape(appearance.shape)
        difference = (other - appearance).astype(np.int32)
        return np.einsum("hwd,hwd->hw", difference, difference)

    hashes = hash_places(_SEED, 0, np.arange(wide), np.arange(high)[:, None])
    if start is None:
        best_rows = (draw(hashes, 0, bottom - top) + top).astype(np.int32)
        best_columns = (draw(hashes, 1, right - left) + left).astype(np.int32)
    else:
        best_rows, best_columns = start
    best = np.full((high, wide), np.iinfo(np.int32).max, np.int32)

    def attempt(rows: NDArray[np.int32], columns: NDArray[np.int32]) -> None:
        rows, columns = rows.clip(top, bottom - 1), columns.clip(left, right - 1)
        near = (np.abs(rows - own_rows) < gap) & (np.abs(columns - own_columns) < gap)
        distances = distance(rows, columns)
        better = (distances < best) & ~near
        np.copyto(best, distances, where=better)
        np.copyto(best_rows, rows, where=better)
        np.copyto(best_columns, columns, where=better)

    first_rows, first_columns = best_rows.copy(), best_columns.copy()
    attempt(first_rows, first_columns)
    line = hash_places(_SEED, 1, np.arange(flat.shape[1]), np.zeros(1, np.int64))
    for index in range(SIMILAR.rounds * SIMILAR.lines):
        directions = draw(line, index, 2 * SIMILAR.steepest + 1) - SIMILAR.steepest
        order = np.argsort(flat.astype(np.int32) @ directions.astype(np.int32), kind="stable")
        for before, after in ((order[:-1], order[1:]), (order[1:], order[:-1])):
            adjacent = np.empty_like(order)
            adjacent[before] = after
            adjacent[order[-1] if before[0] == order[0] else order[0]] = after[0]
            rows, columns = np.divmod(adjacent.reshape(high, wide).astype(np.int32), wide)
            attempt(rows, columns)
        if index % SIMILAR.lines == SIMILAR.lines - 1:
            for y, x in _NEIGHBOURS:
                rows, columns = (np.roll(one, (y, x), (0, 1)) for one in (best_rows, best_columns))
                attempt(rows + np.int32(y), columns + np.int32(x))
    return Similar(best_rows, best_columns, best)
