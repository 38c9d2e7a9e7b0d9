"""Minimum-cost seam through the overlap of two copies of an exemplar (Kwatra et al. 2003).

A minimum cut in which every row is cut once, which dynamic programming finds exactly: from row to
row it may run any way across, at the cost of what it crosses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CutColumns = NDArray[np.int64]


def least_cut(
    differences: NDArray[np.floating], length: float, *, closed: bool
) -> tuple[CutColumns, float]:
    """Where each row changes from one copy to the other, and what that costs a row.

    Args:
        differences: (rows, columns) of the copies, at least 0; at least two columns.
        length: what a step costs besides.
        closed: the last row lies above the first, and the cut ends where it began.

    Returns:
        (rows,): the first column of the second copy, at least 1; and the mean cost.
    """
    between = differences[:, 1:] + differences[:, :-1] + length  # between columns c and c + 1
    following = np.roll(differences, -1, axis=0)
    passed = np.cumsum(differences + following + length, axis=1)[:, :-1]
    if not closed:
        columns, cost = _through(between, passed)
        return columns + 1, cost / len(between)
    # Where a cut of two turns passes between them, one of a single turn is begun.
    twice, _ = _through(np.tile(between, (2, 1)), np.tile(passed, (2, 1)))
    start = int(twice[len(between)])
    columns, cost = _through(between, passed, start)
    cost += abs(float(passed[-1, columns[-1]] - passed[-1, start]))
    return columns + 1, cost / len(between)


def _through(
    between: NDArray[np.floating], passed: NDArray[np.floating], start: int | None = None
) -> tuple[CutColumns, float]:
    """The cheapest columns, and what they cost; from `start` and back to it where that is given."""
    rows, columns = between.shape
    best = between[0].astype(np.float64)
    if start is not None:
        best = np.full(columns, np.inf)
        best[start] = between[0, start]
    came = np.zeros((rows, columns), np.int64)
    order = np.arange(columns)
    for row in range(1, rows):
        way = passed[row - 1]
        rightwards, from_left = _least(best - way, order)
        leftwards, from_right = _least((best + way)[::-1], order)
        leftwards, from_right = leftwards[::-1] - way, columns - 1 - from_right[::-1]
        rightwards = rightwards + way
        left = rightwards <= leftwards
        came[row] = np.where(left, from_left, from_right)
        best = np.where(left, rightwards, leftwards) + between[row]
    ends = best if start is None else best + np.abs(passed[-1] - passed[-1, start])
    path = np.empty(rows, np.int64)
    path[-1] = int(np.argmin(ends))
    for row in range(rows - 1, 0, -1):
        path[row - 1] = came[row, path[row]]
    return path, float(best[path[-1]])


def _least(
    values: NDArray[np.float64], order: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The least of all values up to each, and where the first of it stands."""
    least = np.minimum.accumulate(values)
    fresh = np.concatenate([[True], values[1:] < least[:-1]])
    return least, np.maximum.accumulate(np.where(fresh, order, 0))
