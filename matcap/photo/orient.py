"""Rotates pictures: by EXIF orientation, and from portrait to landscape."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

# Rotates pictures: by EXIF orientation, and from portrait to landscape.


Scalar = TypeVar("Scalar", bound=np.generic)


def upright(picture: NDArray[Scalar], orientation: int) -> NDArray[Scalar]:
    """Upright view of a stored picture (H, W, ...); `orientation` is EXIF's, 1 to 8."""
    if orientation in (5, 6, 7, 8):
        picture = picture.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    return picture


def quarter_turn(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """Rotate (H, W, ...) by 90 degrees counterclockwise: the right side becomes the top."""
    return np.rot90(picture)


def standing(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """The inverse of quarter_turn, contiguous."""
    return np.ascontiguousarray(np.rot90(picture, -1))
