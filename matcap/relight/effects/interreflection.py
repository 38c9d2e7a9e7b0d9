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
from ctypes import byref, c_int64
from typing import TYPE_CHECKING, Any

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.horizons import COARSENESS
from matcap.relight.loops.library import Whole, address, loops
from matcap.relight.scene_bounds import SceneBounds
from matcap.relight.vectors import Array

if TYPE_CHECKING:
    from matcap.relight.block import Block

# Radiance: with no tolerance at all, any change counts.
_TINY: Any = np.float32(1e-30)


def bound(limits: SceneBounds) -> Bound:
    """What neighbours hide of an even sky, times what they reflect.

    Nothing hidden lies higher than the steepest slope's angle e, and a surface tilted by t <= e
    receives pi cos(t) cos(e)^2 from above that, of pi in all: pi (1 - cos(e)^3) is left at most.
    """
    light = sum(one.irradiance for one in limits.lights) + math.pi * limits.sky
    if light == 0.0:
        return Bound(0.0, "there is no light")
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    steepest = math.atan(limits.relief_slope)
    hidden = math.pi * (1.0 - math.cos(steepest) ** 3)
    reason = f"slopes of up to {math.degrees(steepest):.3g} degrees face each other"
    return Bound(limits.lambert**2 * light * hidden, reason)


def add(block: Block) -> None:
    """Add what neighbours reflect: where it may matter, as finely as it may."""
    horizons, size = block.context.horizons, block.context.relief.texture.size
    assert horizons is not None
    for fine, which in _parts(block):
        if not len(which):
            continue
        transfer = horizons.send(block.column, block.row, which, fine=fine)
        loops().matcap_relight_bounce(
            byref(block.as_c), Whole(size[0]), Whole(size[1]), address(transfer),
            c_int64(len(which)), address(which),
        )  # fmt: skip
        block.ran("interreflection", which)


def _parts(block: Block) -> list[tuple[bool, Array]]:
    """Which pixels need it finely, and which coarsely."""
    budget = block.context.budget
    if budget is None:
        return [(True, np.flatnonzero(block.facing).astype(np.int32))]
    assert block.flow is not None and block.context.horizons is not None
    allowed = budget.radiance("interreflection", block.total)
    most: Any = np.float32(0.0)
    for channel in range(3):
        x, y, z = block.flow[3 * channel : 3 * channel + 3]
        largest = np.float32(block.context.relief.texture.brightest[channel] / math.pi)
        change = block.sample.diffuse[channel] * np.sqrt(x * x + y * y + z * z) * largest
        most = np.maximum(most, change * block.open[1] / np.maximum(allowed[channel], _TINY))
    most = most * block.facing
    fine = most * np.float32(COARSENESS) > 1.0
    coarse = (most > 1.0) & ~fine
    return [(one, np.flatnonzero(x).astype(np.int32)) for one, x in ((False, coarse), (True, fine))]
