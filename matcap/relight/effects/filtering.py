"""Texture filtering: maps averaged over a pixel, unresolved normals turned into roughness.

Trilinear lookups in a mip pyramid [williams1983]. The variance of the slopes inside the footprint
widens the lobe, alpha^2 + var(sx) + var(sy): LEAN mapping [olano2010], isotropic here. A distant
bumpy mirror looks rough instead of sparkling. The footprint's longer axis counts, which blurs
grazing views instead of aliasing them.

Left out: bilinear lookups. Cost: eight texels instead of four, and the pyramid, about two passes
over the maps.
"""

from __future__ import annotations

import math

from matcap.relight.effects.bound import Bound
from matcap.relight.scene_bounds import SceneBounds


def bound(limits: SceneBounds) -> Bound:
    """0 where no pixel covers more than a texel; else the picture's largest radiance."""
    if limits.footprint <= 1.0 + 1e-6:
        return Bound(0.0, "no pixel covers more than a texel")
    seen = "infinitely many" if math.isinf(limits.footprint) else f"{limits.footprint:.3g}"
    return Bound(limits.largest_radiance, f"a pixel covers up to {seen} texels")
