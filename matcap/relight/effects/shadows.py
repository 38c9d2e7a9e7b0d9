"""Self-shadowing of the height field.

A ray to the light is compared with the surface where it crosses grid lines through texel centres,
columns first, then rows. On a grid line the bilinear surface is piecewise linear and the test is
exact; between lines the surface deviates by up to a quarter of the cell's |h00 + h11 - h01 - h10|.
A ray ends at the height field's top or at the light. The height field continues beyond the border
of the surface; distant parts of a curved surface cast no shadows.

Left out: attached shadows only (n.l <= 0). Cost: two texels a grid line, over the length of the
highest point's shadow.
"""

from __future__ import annotations

import math

from matcap.relight.effects.bound import Bound
from matcap.relight.scene_bounds import SceneBounds


def bound(limits: SceneBounds) -> Bound:
    """Radiance of the lights that are lower, somewhere, than the relief's steepest slope.

    A height field with slopes up to s casts no shadow under a light whose elevation has tan >= s.
    """
    if not limits.lights:
        return Bound(0.0, "no light casts shadows")
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    slope = limits.relief_slope
    low = [light for light in limits.lights if light.tangent < slope]
    steepest = math.degrees(math.atan(slope))
    lowest = math.degrees(math.atan(min(light.tangent for light in limits.lights)))
    reason = f"lowest light at {lowest:.3g} degrees, steepest slope {steepest:.3g}"
    if not low:
        return Bound(0.0, reason)
    return Bound(sum(limits.radiance(light) for light in low), reason)
