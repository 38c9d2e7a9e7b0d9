"""Scratches, veins and creases: lines that stand out although no texel of them is outstanding.

A scratch is often no brighter than much of the texture that it crosses. Averaged along itself it
is, as the texture's own variation averages out. So a plane is compared with ridges of several
directions. A grain gives the same response everywhere, and thus no large one over the median of
its direction; a scratch across it does.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

# Standard deviations across and along a ridge, and of the surroundings that it is compared with
# across, texels; number of directions.
_WIDTH, _LENGTH, _AROUND = 1.0, 6.0, 2.5
_DIRECTIONS = 12

Floats = NDArray[np.float32]


def streaks(plane: Floats, known: NDArray[np.bool_]) -> Floats:
    """(H, W) largest response of a ridge, over the median response of its direction.

    Args:
        plane: (H, W), with a texel of about half the width of a scratch.
        known: (H, W) texels of which medians are taken.
    """
    reach = round(2.5 * _LENGTH)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    largest = np.zeros_like(plane)
    for angle in np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS:
        along, across = (x * np.cos(each) + y * np.sin(each) for each in (angle, angle + np.pi / 2))
        narrow, wide = (np.exp(-0.5 * (across / each) ** 2) / each for each in (_WIDTH, _AROUND))
        ridge = np.exp(-0.5 * (along / _LENGTH) ** 2) * (narrow - wide)
        response = np.abs(cv2.filter2D(plane, -1, (ridge - ridge.mean()).astype(np.float32)))
        largest = np.maximum(largest, response / max(float(np.median(response[known])), 1e-6))
    return np.asarray(largest, np.float32)
