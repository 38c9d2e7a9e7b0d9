"""Bands of a plane, and wide blurs on fewer texels, which of what is smooth say as much."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]

BLURS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # texels: deviations between bands

_COARSER = 8  # texels a side that are one


def smoothed(plane: Plane, deviation: float) -> Plane:
    """A plane (H, W) blurred by a Gaussian of many texels."""
    return enlarged(coarse_smoothed(plane, deviation), plane.shape)


def coarse_smoothed(plane: Plane, deviation: float) -> Plane:
    """The same on a coarser grid."""
    rows, columns = plane.shape
    size = (max(1, columns // _COARSER), max(1, rows // _COARSER))
    thin = cv2.resize(plane, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(thin, (0, 0), deviation / _COARSER), np.float32)


def enlarged(plane: Plane, shape: tuple[int, ...]) -> Plane:
    """A coarser plane at every texel of a finer one's (H, W)."""
    size = (shape[1], shape[0])
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR), np.float32)


def split(plane: Plane) -> list[Plane]:
    """Bands of a plane (H, W) between BLURS, finest first, and the rest; they add up to it."""
    bands = []
    for blur in BLURS:
        smooth = np.asarray(cv2.GaussianBlur(plane, (0, 0), blur), np.float32)
        bands.append(plane - smooth)
        plane = smooth
    return [*bands, plane]
