"""Parallax and masking: the height moves what a camera sees, and hides what lies behind.

A ray is followed through the height field from its top downwards in steps of at most half a texel
until it is below the surface, then the crossing is found by the secant rule (relief mapping:
Policarpo et al. 2005). A ridge thinner than half a texel of its path may be missed: the bilinear
surface has none thinner than a texel. Curved surfaces are followed in their tangent plane; the
outline of the surface stays that of the undisplaced one.

Left out: the surface is shaded where its undisplaced form stands. Cost: four texels a step, two
steps a texel of shift.
"""

from __future__ import annotations

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts
from matcap.relight.relief import Relief
from matcap.relight.vectors import Array, Vec


def bound(facts: Facts) -> Bound:
    """Nothing on a flat surface; on another, whatever the picture shows."""
    if facts.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    return Bound(facts.everything, f"relief of {facts.relief:.2g} moves what is seen")


def shift(
    relief: Relief, place: tuple[Array, Array], to_view: Vec
) -> tuple[tuple[Array, Array], Array]:
    """Where rays through `place` on the undisplaced surface meet the displaced one.

    Args:
        relief: the height field.
        place: (u, v) in plane units.
        to_view: unit vectors to the camera in the material's frame.

    Returns:
        (u, v) there and the height there, float32 arrays of the block's shape.
    """
    shape = np.broadcast_shapes(place[0].shape, place[1].shape, to_view[2].shape)
    u, v, x, y, z = (np.broadcast_to(a, shape) for a in (*place, *to_view))
    # Per unit of height, how far the ray moves on the surface.
    steep = 1.0 / np.maximum(z, np.float32(0.05))
    du, dv = x * steep, y * steep
    span = relief.high - relief.low
    reach = float(np.hypot(du, dv).max()) * span / relief.texel_size
    count = int(np.clip(np.ceil(2.0 * reach), 4, 512))
    step = span / count
    u0, v0, du0, dv0 = (a.ravel() for a in (u, v, du, dv))
    found: Array = np.full(u0.size, relief.low, dtype=np.float32)
    gap_above: Array = np.full(u0.size, span, dtype=np.float32)
    open_rays = np.arange(u0.size)
    uu, vv, su, sv = u0, v0, du0, dv0
    for index in range(count + 1):
        level = relief.high - step * index
        surface = relief.at(uu + su * level, vv + sv * level)
        gap = np.float32(level) - surface
        below = gap <= 0.0
        if below.any():
            hit = open_rays[below]
            before = gap_above[below]
            # The crossing of two straight lines between the last two steps.
            share = before / np.maximum(before - gap[below], np.float32(1e-12))
            start = np.float32(level + (step if index else 0.0))
            found[hit] = start - np.float32(step if index else 0.0) * share
            keep = ~below
            open_rays, gap = open_rays[keep], gap[keep]
            uu, vv, su, sv = uu[keep], vv[keep], su[keep], sv[keep]
            if not len(open_rays):
                break
        gap_above = gap
    height = found.reshape(shape)
    u, v = u + du * height, v + dv * height
    # The secant ends near the surface; shadows must start on it.
    return (u, v), relief.at(u, v)
