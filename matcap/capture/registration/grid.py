"""Plane points of a grid of texels, and pixels of image coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.flash.extent import OWN, Extent


def grid_points(
    across: int, down: int, extent: Extent = OWN, rows: slice = slice(None)
) -> NDArray[np.float64]:
    """(3, down, across) plane points of a grid's texels, or of some of its rows.

    The layout is that of geometry.plane_points.
    """
    texel = extent.texel(across)
    x = (np.arange(across) + 0.5 - across / 2.0) * texel + extent.middle[0]
    y = (down / 2.0 - np.arange(down)[rows] - 0.5) * texel + extent.middle[1]
    return np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.zeros((len(y), across))])


def to_pixels(
    image: NDArray[np.float64], columns: int, rows: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows of image coordinates (2, ...) for cv2.remap; -1e6 for NaN."""
    x = (image[0] + 1.0) * columns / 2.0 - 0.5
    y = (rows - image[1] * columns) / 2.0 - 0.5
    return (
        np.nan_to_num(x, nan=-1e6).astype(np.float32),
        np.nan_to_num(y, nan=-1e6).astype(np.float32),
    )
