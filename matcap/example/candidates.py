"""k-coherence candidates [tong2002]: for every place of an exemplar the most similar other place.

Approximate nearest neighbours of appearance vectors. Vectors are sorted by their projection on
random directions, and each place tries its neighbours in that order; then, as in PatchMatch
[barnes2009], the shifted candidates of its neighbours in the image. Directions are hashes and
distances integers, so that the result is the same on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.appearance import Appearance
from matcap.example.hashing import draw, hash_places

# The search for candidates; docs/notes/field.md.
_ROUNDS = 4  # more find better candidates and take longer
_LINES = 2  # random directions in a round
_STEEPEST = 100  # largest component of a direction

_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
_SEED = 0x51417


@dataclass(frozen=True)
class Candidates:
    """The candidate of every place of a grid."""

    rows: NDArray[np.int32]
    """(H, W) coordinate of the candidates, grid steps."""
    columns: NDArray[np.int32]
    """(H, W) coordinate of the candidates, grid steps."""


def find_candidates(
    appearance: Appearance,
    gap: int,
    allowed: tuple[slice, slice],
) -> Candidates:
    """For each place the most similar place at least `gap` grid steps away along x or y.

    Args:
        appearance: (H, W, DIMENSIONS).
        gap: grid steps.
        allowed: slices of rows and columns that candidates lie in.
    """
    high, wide = appearance.shape[:2]
    own_rows, own_columns = np.mgrid[0:high, 0:wide].astype(np.int32)
    top, bottom = allowed[0].start, allowed[0].stop
    left, right = allowed[1].start, allowed[1].stop
    flat = appearance.reshape(-1, appearance.shape[2])

    # A vector is gathered as one number of 16 bytes: a third of the time.
    whole = flat.view(np.complex128)[:, 0]

    def distance(rows: NDArray[np.int32], columns: NDArray[np.int32]) -> NDArray[np.int32]:
        other = whole[rows * wide + columns].view(np.int16).reshape(appearance.shape)
        difference = (other - appearance).astype(np.int32)
        return np.einsum("hwd,hwd->hw", difference, difference)

    hashes = hash_places(_SEED, 0, np.arange(wide), np.arange(high)[:, None])
    best_rows = (draw(hashes, 0, bottom - top) + top).astype(np.int32)
    best_columns = (draw(hashes, 1, right - left) + left).astype(np.int32)
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
    for index in range(_ROUNDS * _LINES):
        directions = draw(line, index, 2 * _STEEPEST + 1) - _STEEPEST
        order = _ordered(flat.astype(np.float32) @ directions.astype(np.float32))
        for before, after in ((order[:-1], order[1:]), (order[1:], order[:-1])):
            adjacent = np.empty_like(order)
            adjacent[before] = after
            adjacent[order[-1] if before[0] == order[0] else order[0]] = after[0]
            rows, columns = np.divmod(adjacent.reshape(high, wide).astype(np.int32), wide)
            attempt(rows, columns)
        if index % _LINES == _LINES - 1:
            for y, x in _NEIGHBOURS:
                rows, columns = (np.roll(one, (y, x), (0, 1)) for one in (best_rows, best_columns))
                attempt(rows + np.int32(y), columns + np.int32(x))
    return Candidates(best_rows, best_columns)


def _ordered(numbers: NDArray[np.float32]) -> NDArray[np.int64]:
    """Stable sorting indices of whole numbers below 2^24: sorted with their indices, not by them.

    A projection is at most LARGEST * steepest * DIMENSIONS, below 2^24, hence exact.
    """
    keys = (numbers.astype(np.int64) << 32) | np.arange(len(numbers))
    keys.sort()
    return np.asarray(keys & 0xFFFFFFFF, np.int64)
