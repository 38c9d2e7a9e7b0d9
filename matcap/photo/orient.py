"""Turning pictures: EXIF orientation, and portrait to landscape."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


def upright(picture: NDArray[Scalar], orientation: int) -> NDArray[Scalar]:
    """Turn a stored picture (H, W, ...) to how it was taken, a view of the same numbers.

    Args:
        picture: as stored.
        orientation: EXIF's 1 to 8: which way the stored first row and column lie.
    """
    if orientation in (5, 6, 7, 8):
        picture = picture.swapaxes(0, 1)  # stored rows are columns
    if orientation in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    return picture


def quarter_turn(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """Turn (H, W, ...) a quarter anticlockwise: what was at the right is now at the top."""
    return np.rot90(picture)
