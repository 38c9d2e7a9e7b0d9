"""Normals of a block from its heights, in NumPy; field/source.py has the same in PyTorch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.stated import NormalStyle
from matcap.example.exemplar import Floats
from matcap.field.blocks import RING


def with_normals(maps: Floats, texel_size: float, normal: NormalStyle) -> NDArray[np.float32]:
    """(9 or 11, h, w) maps and normal, of maps (6 or 8, h + 2 RING, w + 2 RING)."""
    height, size = maps[-1], np.float32(2.0 * texel_size)
    across = (height[RING:-RING, 2 * RING :] - height[RING:-RING, : -2 * RING]) / size
    up = (height[: -2 * RING, RING:-RING] - height[2 * RING :, RING:-RING]) / size
    upright = np.float32(1.0) / np.sqrt(np.float32(1.0) + across * across + up * up)
    planes = np.empty((len(maps) + 3, *across.shape), np.float32)
    planes[:-3] = maps[:, RING:-RING, RING:-RING]
    np.multiply(across, -upright, out=planes[-3])
    np.multiply(up, upright if normal == "dx" else -upright, out=planes[-2])
    planes[-1] = upright
    return planes
