"""Vectors as three arrays, so that an axis that is the same for a whole row or block stays small.

Components broadcast against each other: on a plane seen from straight above, x varies along rows
only, y along columns only and z not at all, and most of the arithmetic shrinks accordingly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Any numbers: NumPy knows which, and the arithmetic below keeps it.
Array = NDArray[Any]
Vec = tuple[Array, Array, Array]


def vec(vector: tuple[float, float, float], dtype: Any = np.float32) -> Vec:  # noqa: ANN401
    """A constant vector."""
    x, y, z = (np.asarray(c, dtype=dtype) for c in vector)
    return x, y, z


def dot(a: Vec, b: Vec) -> Array:
    """Scalar product."""
    total: Array = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return total


def cross(a: Vec, b: Vec) -> Vec:
    """Vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def scale(a: Vec, factor: Array | float) -> Vec:
    """Every component times a factor."""
    return a[0] * factor, a[1] * factor, a[2] * factor


def add(a: Vec, b: Vec) -> Vec:
    """Sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vec, b: Vec) -> Vec:
    """Difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def unit(a: Vec) -> Vec:
    """Length 1; a zero vector stays zero."""
    return scale(a, 1.0 / np.sqrt(np.maximum(dot(a, a), np.float32(1e-30))))


def unit3(vector: tuple[float, float, float]) -> NDArray[np.float64]:
    """(3,) float64 of length 1."""
    array = np.asarray(vector, dtype=np.float64)
    normalized: NDArray[np.float64] = array / np.linalg.norm(array)
    return normalized
