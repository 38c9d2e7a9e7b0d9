"""Filtering of distant material: normals that a pixel cannot resolve become roughness.

Maps are averaged over a pixel's footprint (a pyramid, trilinear; Williams 1983); the variance of
the slopes inside is added to alpha squared, 2 sigma^2 an axis, so that a far bumpy mirror looks
rough instead of sparkling (LEAN mapping, Olano and Baker 2010; isotropic here, alpha^2 plus
var(sx) + var(sy)). The footprint is its longer axis, which blurs grazing views rather than
letting them flicker.

Left out: the four texels around a pixel's centre. Cost: eight texels instead of four, and the
pyramid, about two passes over the maps.
"""

from __future__ import annotations

import math

from matcap.relight.effects.bound import Bound
from matcap.relight.scene_bounds import SceneBounds


def bound(limits: SceneBounds) -> Bound:
    """Nothing while no pixel covers more than a texel; else whatever the picture shows."""
    if limits.footprint <= 1.0 + 1e-6:
        return Bound(0.0, "no pixel covers more than a texel")
    seen = "infinitely many" if math.isinf(limits.footprint) else f"{limits.footprint:.3g}"
    return Bound(limits.everything, f"a pixel covers up to {seen} texels")
