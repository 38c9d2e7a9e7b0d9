"""Ambient visibility: relief hides part of the surroundings (horizon mapping: Max 1988).

Diffuse light of the surroundings is multiplied by the share of an even sky that a texel sees; each
mirrored direction is compared with the horizon between the two nearest of 16 azimuths. Both from
matcap.relight.horizons, once a material.

Left out: every point sees all that stands above the plane. Cost: some 300 passes over the maps,
once; two lookups a mirrored direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts
from matcap.relight.horizons import AZIMUTHS
from matcap.relight.vectors import Array, Vec


def bound(facts: Facts) -> Bound:
    """Whatever the surroundings cause, where there is any relief to hide them."""
    if facts.sky == 0.0:
        return Bound(0.0, "there are no surroundings")
    if facts.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    slope = math.degrees(math.atan(facts.relief_slope))
    return Bound(facts.surroundings, f"horizons of up to {slope:.3g} degrees")


@dataclass(frozen=True)
class HorizonTest:
    """Whether directions in the material's frame are above the horizon of texels.

    Attributes:
        tangents: (H W, AZIMUTHS) of the material's horizons.
        texel: index of each pixel's nearest texel.
    """

    tangents: Array
    texel: Array

    def __call__(self, direction: Vec, some: Array | None) -> Array:
        """Of directions, and of which pixels they belong to, counted row by row; None is all."""
        flat = self.tangents.ravel()
        x, y, z = direction
        texel = self.texel.reshape(z.shape) if some is None else np.take(self.texel, some)
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
