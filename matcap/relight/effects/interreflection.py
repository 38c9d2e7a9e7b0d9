"""One diffuse bounce of light between neighbouring parts of the relief.

From matcap.relight.horizons: for each texel and colour a vector t, so that light of irradiance e
along l sends the texel t . (e l) by way of its neighbours: a precomputed transfer (Sloan et al.
2002) of one bounce, so that another light costs one scalar product. It takes neighbours to be lit
by the same light, not to shade each other, and lets those that face away from a light count
negative where truly they count nothing; the sum is kept from going below 0. What is received is
reflected diffusely.

Left out: light goes from lamp to surface to camera only. Cost: some 8000 operations a texel, once;
a lookup of nine numbers a pixel.
"""

from __future__ import annotations

import math

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts
from matcap.relight.vectors import Array, Vec, dot


def bound(facts: Facts) -> Bound:
    """What neighbours hide of an even sky, times what they reflect.

    Nothing hidden lies higher than the steepest slope's angle e, and a surface tilted by t <= e
    receives pi cos(t) cos(e)^2 from above that, of pi in all: pi (1 - cos(e)^3) is left at most.
    """
    light = sum(one.irradiance for one in facts.lights) + math.pi * facts.sky
    if light == 0.0:
        return Bound(0.0, "there is no light")
    if facts.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    steepest = math.atan(facts.relief_slope)
    hidden = math.pi * (1.0 - math.cos(steepest) ** 3)
    reason = f"slopes of up to {math.degrees(steepest):.3g} degrees face each other"
    return Bound(facts.lambert**2 * light * hidden, reason)


def received(bounced: Array, light: list[Vec]) -> list[Array]:
    """Irradiance by way of neighbours, one array a colour.

    Args:
        bounced: (9, ...) transfer vectors at the pixels.
        light: for each colour, the sum of irradiance times direction.
    """
    zero = np.float32(0.0)
    return [np.maximum(dot(tuple(bounced[3 * c : 3 * c + 3]), light[c]), zero) for c in range(3)]
