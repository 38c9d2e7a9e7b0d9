"""Directions against horizons, plainly: what matcap.relight.loops is held to."""

import math

import numpy as np

from matcap.relight.camera import Array, Vec
from matcap.relight.loops.library import AZIMUTHS


def above_horizon(tangents: Array, direction: Vec) -> Array:
    """Whether directions in the material's frame are above horizons.

    Args:
        tangents: (N, AZIMUTHS) of each pixel's texel.
        direction: one for each pixel.
    """
    x, y, z = direction
    turn = np.arctan2(y, x) * np.float32(AZIMUTHS / (2.0 * math.pi))
    low = np.floor(turn)
    pixel, first = np.arange(len(tangents)), low.astype(int) % AZIMUTHS
    here, beside = tangents[pixel, first], tangents[pixel, (first + 1) % AZIMUTHS]
    return z > (here + (turn - low) * (beside - here)) * np.sqrt(x * x + y * y)
