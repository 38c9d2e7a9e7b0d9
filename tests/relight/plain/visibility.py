"""Directions against horizons, plainly: what matcap.relight.loops is held to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from matcap.relight.loops.library import AZIMUTHS
from matcap.relight.vectors import Array, Vec


@dataclass(frozen=True)
class HorizonTest:
    """Whether directions in the material's frame are above the horizon of texels.

    Attributes:
        tangents: (H W, AZIMUTHS) of the material's horizons.
        texel: index of each pixel's nearest texel.
    """

    tangents: Array
    texel: Array

    def __call__(self, direction: Vec) -> Array:
        """Of directions, one for each pixel."""
        flat = self.tangents.ravel()
        x, y, z = direction
        texel = self.texel.reshape(z.shape)
        start = texel * AZIMUTHS
        turn = np.arctan2(y, x) * np.float32(AZIMUTHS / (2.0 * math.pi))
        low = np.floor(turn)
        share = turn - low
        first = low.astype(np.int32) & (AZIMUTHS - 1)
        second = (first + 1) & (AZIMUTHS - 1)
        t0 = flat[start + first]
        tangent: Array = t0 + share * (flat[start + second] - t0)
        above: Array = z > tangent * np.sqrt(x * x + y * y)
        return above
