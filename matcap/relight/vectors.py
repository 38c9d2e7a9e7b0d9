"""Vectors as tuples of three arrays that broadcast against each other.

On a plane seen from straight above x is (1, W), y (H, 1) and z (1, 1), and arithmetic is cheap
accordingly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Of any dtype: the functions below keep it.
Array = NDArray[Any]
Vec = tuple[Array, Array, Array]


def vec(vector: tuple[float, float, float]) -> Vec:
    """A constant vector as three 0-d float32 arrays."""
    x, y, z = (np.asarray(c, dtype=np.float32) for c in vector)
    return x, y, z


def dot(a: Vec, b: Vec) -> Array:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def scale(a: Vec, factor: Array | float) -> Vec:
    """Every component times a factor."""
    return a[0] * factor, a[1] * factor, a[2] * factor


def add(a: Vec, b: Vec) -> Vec:
    """Sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vec, b: Vec) -> Vec:
    """Difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def unit3(vector: tuple[float, float, float]) -> NDArray[np.float64]:
    """(3,) float64 unit vector."""
    array = np.asarray(vector, dtype=np.float64)
    return array / np.linalg.norm(array)
