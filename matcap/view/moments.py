"""Moments: quantities whose averages are the mip levels of a material [olano2010].

Nine planes, float32: diffuse albedo (3), F0 (1), alpha^2, slopes along x and y, the sum of squared
slopes, height; eleven where F0 has three channels. All are linear under averaging, as in
relight/sampling.py: the variance of slopes within a coarse texel adds to its alpha^2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Planes = NDArray[np.float32]

DIFFUSE, F0 = slice(0, 3), slice(3, -5)
ALBEDO = slice(0, -5)  # diffuse and F0
ALPHA2, SLOPE_X, SLOPE_Y, SQUARES, HEIGHT = -5, -4, -3, -2, -1
RING = 1  # texels around maps, for central differences
_LEAST_ROUGHNESS = np.float32(1e-3)  # as in brdf/cook_torrance.py


def moments_of(stacked: Planes, texel_size: float) -> Planes:
    """(9 or 11, H, W) moments of stacked maps (6 or 8, H + 2 RING, W + 2 RING).

    Slopes are central differences.
    """
    *_, roughness, height = stacked
    inner = stacked[:, RING:-RING, RING:-RING]
    step = np.float32(0.5 / texel_size)
    moments = np.empty((len(stacked) + 3, *inner.shape[1:]), np.float32)
    moments[ALBEDO] = inner[:-2]
    rough = np.maximum(roughness[RING:-RING, RING:-RING], _LEAST_ROUGHNESS)
    moments[ALPHA2] = np.square(np.square(rough))
    moments[SLOPE_X] = (height[RING:-RING, 2 * RING :] - height[RING:-RING, : -2 * RING]) * step
    moments[SLOPE_Y] = (height[: -2 * RING, RING:-RING] - height[2 * RING :, RING:-RING]) * step
    moments[SQUARES] = np.square(moments[SLOPE_X]) + np.square(moments[SLOPE_Y])
    moments[HEIGHT] = inner[-1]
    return moments


def halved(moments: Planes) -> Planes:
    """Averages of 2 x 2 texels; both sides must be even."""
    rows = moments[:, 0::2] + moments[:, 1::2]
    return (rows[:, :, 0::2] + rows[:, :, 1::2]) * np.float32(0.25)


def edged(stacked: Planes) -> Planes:
    """Pad stacked maps by RING texels so that slopes at the borders are one-sided differences."""
    grown = np.pad(stacked, ((0, 0), (RING, RING), (RING, RING)), mode="edge")
    height = grown[-1]
    height[0], height[-1] = 2 * height[1] - height[2], 2 * height[-2] - height[-3]
    height[:, 0] = 2 * height[:, 1] - height[:, 2]
    height[:, -1] = 2 * height[:, -2] - height[:, -3]
    return grown


def mean_of(moments: Planes) -> tuple[float, ...]:
    """Mean of each plane."""
    return tuple(float(one) for one in moments.mean(axis=(1, 2), dtype=np.float64))
