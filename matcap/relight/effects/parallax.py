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

from matcap.relight import compiled
from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts
from matcap.relight.relief import Relief
from matcap.relight.vectors import Array, Vec

# Texels around a place on a ray whose highest says how many steps can be left out.
_AROUND = 10


def bound(facts: Facts) -> Bound:
    """Nothing on a flat surface; on another, whatever the picture shows."""
    if facts.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    return Bound(facts.everything, f"relief of {facts.relief:.2g} moves what is seen")


def shift(
    relief: Relief, place: tuple[Array, Array], to_view: Vec, *, quick: bool = False
) -> tuple[tuple[Array, Array], Array]:
    """Where rays through `place` on the undisplaced surface meet the displaced one.

    Args:
        relief: the height field.
        place: (u, v) in plane units.
        to_view: unit vectors to the camera in the material's frame.
        quick: by the compiled loop, where there is one.

    Returns:
        (u, v) there and the height there, float32 arrays of the block's shape.
    """
    shape = np.broadcast_shapes(place[0].shape, place[1].shape, to_view[2].shape)
    u, v, x, y, z = (np.broadcast_to(a, shape) for a in (*place, *to_view))
    # Per unit of height, how far the ray moves on the surface.
    steep = 1.0 / np.maximum(z, np.float32(0.05))
    du, dv = x * steep, y * steep
    height = _met(relief, *(a.ravel() for a in (u, v, du, dv)), quick=quick).reshape(shape)
    u, v = u + du * height, v + dv * height
    # The secant ends near the surface; shadows must start on it.
    return (u, v), relief.at(u, v)


def _met(relief: Relief, u: Array, v: Array, du: Array, dv: Array, *, quick: bool) -> Array:
    """The heights at which rays meet the surface.

    Each takes as many steps as it needs itself, wherever in the picture it is, and leaves out
    those on which it is above all texels around.
    """
    found: Array = np.full(u.size, relief.low, dtype=np.float32)
    span = relief.high - relief.low
    pace = np.hypot(du, dv) * np.float32(span / relief.texel_size)
    count = np.clip(np.ceil(3.0 * pace), 8.0, 512.0)
    step = span / count.astype(np.float64)
    # So many steps stay where the highest texel is known.
    near = np.maximum(np.floor((_AROUND - 2) * count / np.maximum(pace, 1e-6)), 1.0)
    if quick and compiled.kernel() is not None:
        return compiled.met(relief, _AROUND, (u, v), (du, dv), count, near)
    peaks = relief.peaks(_AROUND)
    rays: Array = np.arange(u.size)
    index: Array = np.zeros(u.size)
    while len(rays):
        level = relief.high - step * index
        uu, vv = u + du * level, v + dv * level
        gap = level - relief.at(uu, vv)
        below = gap <= 0.0
        if below.any():
            hit = np.flatnonzero(below)
            # The crossing of two straight lines between the last two steps.
            before = np.where(index[hit] > 0.0, level[hit] + step[hit], level[hit])
            over = before - relief.at(u[hit] + du[hit] * before, v[hit] + dv[hit] * before)
            share = over / np.maximum(over - gap[hit], 1e-12)
            found[rays[hit]] = before - (before - level[hit]) * share
        # Above the highest texel around there is nothing to meet.
        clear = np.floor((level - np.take(peaks, relief.nearest(uu, vv))) / np.maximum(step, 1e-30))
        index += np.clip(clear - 1.0, 1.0, near)
        keep = np.flatnonzero(~below & (index <= count))
        if len(keep) < len(rays):
            rays, index, count = rays[keep], index[keep], count[keep]
            step, near = step[keep], near[keep]
            u, v, du, dv = u[keep], v[keep], du[keep], dv[keep]
    return found
