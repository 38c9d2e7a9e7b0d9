"""The compiled loops (kernel.c), and exact integers at places: random ones, and phases of waves."""

from __future__ import annotations

import ctypes
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.files.process import find_library, not_built

# Random integers as a pure function of (seed, level, x, y), exact anywhere in [-2^40, 2^40].
#
# The counter-based hash of space/random_field.py, in NumPy: column and row are hashed separately,
# combined, and hashed again, all modulo 2^64.

Hashes = NDArray[np.uint64]
Integers = NDArray[np.int64]
Positions = tuple[Integers, Integers]  # x, y

_WORD = 2**64
_GOLDEN = 0x9E3779B97F4A7C15  # 2^64 / golden ratio: the step of splitmix64
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)  # the multipliers of splitmix64's finaliser
_MIX_2 = np.uint64(0x94D049BB133111EB)  # [steele2014]
_DRAW = 0xD6E8FEB86659FD93  # makes the draws of one place independent


def scramble(value: Hashes) -> Hashes:
    """splitmix64's finaliser [steele2014]: a bijection in which each bit affects all others."""
    value = (value ^ (value >> np.uint64(30))) * _MIX_1
    value = (value ^ (value >> np.uint64(27))) * _MIX_2
    return value ^ (value >> np.uint64(31))


def hash_places(seed: int, level: int, x: Integers, y: Integers) -> Hashes:
    """Hashes of positions.

    Args:
        seed: in [-2^63, 2^63).
        level: hashes of different levels are independent.
        x, y: columns and rows, of shapes that broadcast.
    """
    start = scramble(np.array([(seed + _GOLDEN) % _WORD], np.uint64))
    counter = [(2 * level + 1) * _GOLDEN % _WORD, (2 * level + 2) * _GOLDEN % _WORD]
    for_column, for_row = scramble(np.array(counter, np.uint64) + start)
    golden = np.uint64(_GOLDEN)
    column = scramble(x.astype(np.uint64) * golden + for_column)
    return scramble(column ^ scramble(y.astype(np.uint64) * golden + for_row))


def draw(hashes: Hashes, index: int, count: int) -> Integers:
    """The index-th random integer in [0, count) of each hash; count is at most 2^31."""
    bits = scramble(hashes + np.array([index * _DRAW % _WORD], np.uint64)) >> np.uint64(32)
    return (bits * np.uint64(count) >> np.uint64(32)).astype(np.int64)


def draws(hashes: Hashes, indices: range, count: int) -> Integers:
    """(indices, ...) random integers, as draw() of each index."""
    strides = np.array([index * _DRAW % _WORD for index in indices], np.uint64)
    return draw(hashes + strides.reshape(-1, *[1] * hashes.ndim), 0, count)


# Exact phases of plane waves on the endless plane, in integers of 2^-64 turn.
#
# The phase at texel (x, y) is x * step_x + y * step_y + start, a sum of Python's integers. It has
# no rounding error however far away a texel lies, and wraps modulo 2^64 as turns do.


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


# Loads the compiled loops (kernel.c).

_FORM = 6  # version of kernel.c's interface


@cache
def built() -> Any | None:  # noqa: ANN401
    """The library, or None if it is missing or of another version."""
    return find_library(Path(__file__).parent, ("matcap_form", _FORM))


def loops() -> Any:  # noqa: ANN401
    """The library.

    Raises:
        MatcapError: it is missing or of another version.
    """
    library = built()
    if library is None:
        raise not_built("fields by example")
    return library


def address(array: NDArray[Any]) -> ctypes.c_void_p:
    """Pointer to a contiguous array's data."""
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)
