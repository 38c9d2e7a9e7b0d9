"""Ambient visibility: relief hides part of the surroundings (horizon mapping: Max 1988).

Diffuse light of the surroundings is multiplied by the share of an even sky that a texel sees; each
mirrored direction is compared with the horizon between the two nearest of 16 azimuths. Both from
matcap.relight.horizons, once a material.

Left out: every point sees all that stands above the plane. Cost: some 500 texels a texel that is
seen, once a material; two lookups a mirrored direction.
"""

from __future__ import annotations

import math

from matcap.relight.effects.bound import Bound
from matcap.relight.scene_bounds import SceneBounds


def bound(limits: SceneBounds) -> Bound:
    """Whatever the surroundings cause, where there is any relief to hide them."""
    if limits.sky == 0.0:
        return Bound(0.0, "there are no surroundings")
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    slope = math.degrees(math.atan(limits.relief_slope))
    return Bound(limits.surroundings, f"horizons of up to {slope:.3g} degrees")
