"""Moments: means that the page filters a material by, so that it looks right at a distance.

Nine planes a texel, float32: diffuse albedo (3), F0, alpha squared, slopes along x and y, the sum
of their squares, height; eleven where F0 has a colour, and so three channels. All of them may be
averaged, as matcap/relight/sampling.py averages them: what slopes vary within a coarse texel is
roughness from afar.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Planes = NDArray[np.float32]

DIFFUSE, F0 = slice(0, 3), slice(3, -5)
ALBEDO = slice(0, -5)  # both
ALPHA2, SLOPE_X, SLOPE_Y, SQUARES, HEIGHT = -5, -4, -3, -2, -1
RING = 1  # texels around them that slopes are differences of
_LEAST_ROUGHNESS = np.float32(1e-3)  # as in brdf/cook_torrance.py


def moments_of(stacked: Planes, texel_size: float) -> Planes:
    """Of stacked maps (6 or 8, H + 2 RING, W + 2 RING): their moments (9 or 11, H, W), slopes
    central.
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
    """Means of squares of four; both sides are even."""
    rows = moments[:, 0::2] + moments[:, 1::2]
    return (rows[:, :, 0::2] + rows[:, :, 1::2]) * np.float32(0.25)


def edged(stacked: Planes) -> Planes:
    """Stacked maps with a ring around them, such that slopes at the borders are one-sided."""
    grown = np.pad(stacked, ((0, 0), (RING, RING), (RING, RING)), mode="edge")
    height = grown[-1]
    height[0], height[-1] = 2 * height[1] - height[2], 2 * height[-2] - height[-3]
    height[:, 0] = 2 * height[:, 1] - height[:, 2]
    height[:, -1] = 2 * height[:, -2] - height[:, -3]
    return grown


def wrapped(stacked: Planes) -> Planes:
    """Stacked maps with a ring around them that repeats them."""
    return np.pad(stacked, ((0, 0), (RING, RING), (RING, RING)), mode="wrap")


def mean_of(moments: Planes) -> tuple[float, ...]:
    """Of all texels: a number a plane."""
    return tuple(float(one) for one in moments.mean(axis=(1, 2), dtype=np.float64))
