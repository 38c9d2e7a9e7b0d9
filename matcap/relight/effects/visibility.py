"""Visibility of environments over the relief: horizon maps [max1988].

Diffuse irradiance is multiplied by the texel's sky view factor. Each sampled direction of the
specular lobe is compared with the horizon, interpolated between the two nearest of 16 azimuths
(matcap.relight.horizons).

Left out: every point sees the whole upper hemisphere. Cost: about 500 texels a visible texel, once
a material; two lookups a sampled direction.
"""

from __future__ import annotations

import math

from matcap.relight.effects.bound import Bound
from matcap.relight.scene_bounds import SceneBounds


def bound(limits: SceneBounds) -> Bound:
    """0 on a flat surface; else the largest radiance reflected from the environments."""
    if limits.environment == 0.0:
        return Bound(0.0, "there is no environment light")
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    slope = math.degrees(math.atan(limits.relief_slope))
    return Bound(limits.environment_radiance, f"horizons of up to {slope:.3g} degrees")
