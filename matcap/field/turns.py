"""Exact phases of plane waves on the endless plane, in integers of 2^-64 turn."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from matcap.files.settings import COORDINATE_LIMIT as COORDINATE_LIMIT
from matcap.files.settings import Rectangle as Rectangle

# The phase at texel (x, y) is x * step_x + y * step_y + start, a sum of Python's integers. It has
# no rounding error however far away a texel lies, and wraps modulo 2^64 as turns do.

Integers = NDArray[np.int64]


def turns_per_texel(frequency: float, period: int | None) -> int:
    """A frequency in cycles per texel as 2^-64 turns per texel, in [-2^63, 2^63).

    With a period it is the nearest frequency that makes whole cycles in it.
    """
    exact = frequency * 2**64
    if period is not None:
        exact = round(frequency * period) * 2**64 / period
    return (round(exact) + 2**63) % 2**64 - 2**63


def whole_turns(columns: list[int], rows: list[int]) -> Integers:
    """(rows, columns) whole turns of column + row, both in 2^-64 turn: floor division by 2^64.

    Computed from the upper and the lower 64 bits of each, with the carry between them.
    """
    (column_high, column_low), (row_high, row_low) = _halves(columns), _halves(rows)
    carry = (row_low[:, None] + column_low[None, :]) < column_low[None, :]
    return row_high[:, None] + column_high[None, :] + carry


def _halves(values: list[int]) -> tuple[Integers, NDArray[np.uint64]]:
    high = np.array([value >> 64 for value in values], np.int64)
    return high, np.array([value % 2**64 for value in values], np.uint64)


def same_cells(
    first: Integers, second: Integers, along_x: tuple[int, int], along_y: tuple[int, int]
) -> tuple[Integers, Integers]:
    """One representative (first, second) for all lattice cells that a periodic field repeats.

    Args:
        first, second: whole turns of both waves, which number a cell.
        along_x, along_y: turns of both waves in the field's period along x and along y; (0, 0)
            along an axis without a period.
    """
    # Euclid's algorithm on both repeats, until the second leaves the first wave's number as it is.
    while along_y[0]:
        times = along_x[0] // along_y[0]
        rest = along_x[0] - times * along_y[0], along_x[1] - times * along_y[1]
        along_x, along_y = along_y, rest
    if along_x[0]:
        repeats = first // along_x[0]
        first, second = first - repeats * along_x[0], second - repeats * along_x[1]
        size = abs(along_y[1])
    else:
        size = math.gcd(along_x[1], along_y[1])
    return first, second % size if size else second
