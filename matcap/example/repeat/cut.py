"""Minimum-cost seam through the overlap of two copies of an exemplar [kwatra2003].

The seam crosses every row once and may run any distance along a row, at the cost of the texels it
passes. Dynamic programming finds the exact minimum.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CutColumns = NDArray[np.int64]


def least_cut(
    differences: NDArray[np.floating], length: float, *, closed: bool
) -> tuple[CutColumns, float]:
    """The seam of least cost from the first row to the last.

    Args:
        differences: (rows, columns) of both copies, at least 0; at least two columns.
        length: cost of each step of the seam, added to the differences.
        closed: the rows are periodic, and the seam ends where it began.

    Returns:
        (rows,) first column of the second copy, at least 1; and the mean cost a row.
    """
    between = differences[:, 1:] + differences[:, :-1] + length  # between columns c and c + 1
    following = np.roll(differences, -1, axis=0)
    # Cumulative cost of running along the border between a row and the next.
    passed = np.cumsum(differences + following + length, axis=1)[:, :-1]
    if not closed:
        columns, cost = _through(between, passed)
        return columns + 1, cost / len(between)
    # A closed seam is searched from a column that a seam of two periods crosses in its middle.
    twice, _ = _through(np.tile(between, (2, 1)), np.tile(passed, (2, 1)))
    start = int(twice[len(between)])
    columns, cost = _through(between, passed, start)
    cost += abs(float(passed[-1, columns[-1]] - passed[-1, start]))
    return columns + 1, cost / len(between)


def _through(
    between: NDArray[np.floating], passed: NDArray[np.floating], start: int | None = None
) -> tuple[CutColumns, float]:
    """Columns of the cheapest seam, and its cost; with a `start` it begins and ends there."""
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
    """Running minimum of values, and the index of its first occurrence."""
    least = np.minimum.accumulate(values)
    fresh = np.concatenate([[True], values[1:] < least[:-1]])
    return least, np.maximum.accumulate(np.where(fresh, order, 0))
