"""One diffuse bounce between neighbouring parts of the relief, by precomputed transfer [sloan2002].

matcap.relight.horizons computes for each texel and colour a vector t: light of irradiance e from
direction l sends the texel irradiance t . (e l) by way of its neighbours. All lights together are
one scalar product with the vector irradiance. Approximations: neighbours receive the texel's own
light, without shadows; neighbours that face away from it count negative instead of 0, and the sum
is clamped to 0. The texel reflects diffusely.

Left out: no bounce. Cost: about 8000 operations a texel, once; a lookup of nine numbers a pixel.
"""

from __future__ import annotations

import math
from ctypes import byref, c_int64
from typing import Any

import numpy as np

from matcap.relight.block import Block
from matcap.relight.effects.bound import Bound
from matcap.relight.horizons import COARSENESS
from matcap.relight.loops.library import Whole, address, loops
from matcap.relight.scene_bounds import SceneBounds
from matcap.relight.vectors import Array

# Radiance that stands for a tolerance of 0, in a denominator.
_TINY: Any = np.float32(1e-30)


def bound(limits: SceneBounds) -> Bound:
    """(albedo / pi)^2 times irradiance times the projected solid angle that neighbours can fill.

    No neighbour is higher than e, the angle of the steepest slope. A normal tilted by t <= e has
    projected solid angle pi cos(t) cos(e)^2 above e, of pi in all: neighbours fill at most
    pi (1 - cos(e)^3).
    """
    light = sum(one.irradiance for one in limits.lights) + math.pi * limits.environment
    if light == 0.0:
        return Bound(0.0, "there is no light")
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    steepest = math.atan(limits.relief_slope)
    hidden = math.pi * (1.0 - math.cos(steepest) ** 3)
    reason = f"slopes of up to {math.degrees(steepest):.3g} degrees light each other"
    return Bound(limits.lambert**2 * light * hidden, reason)


def add(block: Block) -> None:
    """Add the bounce to a block, in the pixels and with the precision that the budget asks for."""
    horizons, size = block.context.horizons, block.context.relief.texture.size
    assert horizons is not None
    for fine, which in _parts(block):
        if not len(which):
            continue
        transfer = horizons.transfer(block.column, block.row, which, fine=fine)
        loops().matcap_relight_bounce(
            byref(block.as_c), Whole(size[0]), Whole(size[1]), address(transfer),
            c_int64(len(which)), address(which),
        )  # fmt: skip
        block.ran("interreflection", which)


def _parts(block: Block) -> list[tuple[bool, Array]]:
    """Indices of the pixels that need coarse transfer (False) and fine transfer (True)."""
    budget = block.context.budget
    if budget is None:
        return [(True, np.flatnonzero(block.facing).astype(np.int32))]
    assert block.vector_irradiance is not None and block.context.horizons is not None
    allowed = budget.radiance("interreflection", block.total)
    most: Any = np.float32(0.0)
    for channel in range(3):
        x, y, z = block.vector_irradiance[3 * channel : 3 * channel + 3]
        largest = np.float32(block.context.relief.texture.brightest[channel] / math.pi)
        change = block.sample.diffuse[channel] * np.sqrt(x * x + y * y + z * z) * largest
        most = np.maximum(most, change * block.open[1] / np.maximum(allowed[channel], _TINY))
    most = most * block.facing
    fine = most * np.float32(COARSENESS) > 1.0
    coarse = (most > 1.0) & ~fine
    return [(one, np.flatnonzero(x).astype(np.int32)) for one, x in ((False, coarse), (True, fine))]
