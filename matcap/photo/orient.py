"""Rotates pictures from portrait to landscape and back; files/pixels.py: by EXIF orientation."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


def quarter_turn(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """Rotate (H, W, ...) by 90 degrees counterclockwise: the right side becomes the top."""
    return np.rot90(picture)


def standing(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """The inverse of quarter_turn, contiguous."""
    return np.ascontiguousarray(np.rot90(picture, -1))
