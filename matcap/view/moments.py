"""Moments: what the page averages of a material, so that it looks right from afar.

Nine planes a texel, float32: diffuse albedo (3), F0, alpha squared, slopes along x and y, the sum
of their squares, height. All of them may be averaged, as matcap/relight/sampling.py averages them:
what slopes vary within a coarse texel is roughness from afar.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Planes = NDArray[np.float32]

PLANES = 9
ALPHA2, SLOPE_X, SLOPE_Y, SQUARES, HEIGHT = 4, 5, 6, 7, 8
RING = 1  # texels around them that slopes are differences of
_LEAST_ROUGHNESS = np.float32(1e-3)  # as in brdf/cook_torrance.py


def moments_of(stacked: Planes, texel_size: float) -> Planes:
    """Of stacked maps (6, H + 2 RING, W + 2 RING): their moments (9, H, W), slopes central."""
    height = stacked[5]
    inner = stacked[:, RING:-RING, RING:-RING]
    step = np.float32(0.5 / texel_size)
    found = np.empty((PLANES, *inner.shape[1:]), np.float32)
    found[:4] = inner[:4]
    found[ALPHA2] = np.square(np.square(np.maximum(inner[4], _LEAST_ROUGHNESS)))
    found[SLOPE_X] = (height[RING:-RING, 2 * RING :] - height[RING:-RING, : -2 * RING]) * step
    found[SLOPE_Y] = (height[: -2 * RING, RING:-RING] - height[2 * RING :, RING:-RING]) * step
    found[SQUARES] = np.square(found[SLOPE_X]) + np.square(found[SLOPE_Y])
    found[HEIGHT] = inner[5]
    return found


def halved(moments: Planes) -> Planes:
    """Means of squares of four; both sides are even."""
    rows = moments[:, 0::2] + moments[:, 1::2]
    return (rows[:, :, 0::2] + rows[:, :, 1::2]) * np.float32(0.25)


def edged(stacked: Planes) -> Planes:
    """Stacked maps with a ring around them, such that slopes at the borders are one-sided."""
    grown = np.pad(stacked, ((0, 0), (RING, RING), (RING, RING)), mode="edge")
    height = grown[5]
    height[0], height[-1] = 2 * height[1] - height[2], 2 * height[-2] - height[-3]
    height[:, 0] = 2 * height[:, 1] - height[:, 2]
    height[:, -1] = 2 * height[:, -2] - height[:, -3]
    return grown


def wrapped(stacked: Planes) -> Planes:
    """Stacked maps with a ring around them that repeats them."""
    return np.pad(stacked, ((0, 0), (RING, RING), (RING, RING)), mode="wrap")


def mean_of(moments: Planes) -> tuple[float, ...]:
    """Of all texels: nine numbers."""
    return tuple(float(one) for one in moments.mean(axis=(1, 2), dtype=np.float64))
