"""Rays through relief, many side by side, plainly: what matcap.relight.loops is held to."""

from __future__ import annotations

import numpy as np

from matcap.relight.relief import Relief
from matcap.relight.vectors import Array, Vec
from plain.relief import at, nearest

# Texels around a place on a ray whose highest says how many steps can be left out.
_AROUND = 10


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
    height = _met(relief, *(a.ravel() for a in (u, v, du, dv))).reshape(shape)
    u, v = u + du * height, v + dv * height
    # The secant ends near the surface; shadows must start on it.
    return (u, v), at(relief, u, v)


def _met(relief: Relief, u: Array, v: Array, du: Array, dv: Array) -> Array:
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
    peaks = relief.peaks(_AROUND)
    rays: Array = np.arange(u.size)
    index: Array = np.zeros(u.size)
    while len(rays):
        level = relief.high - step * index
        uu, vv = u + du * level, v + dv * level
        gap = level - at(relief, uu, vv)
        below = gap <= 0.0
        if below.any():
            hit = np.flatnonzero(below)
            # The crossing of two straight lines between the last two steps.
            before = np.where(index[hit] > 0.0, level[hit] + step[hit], level[hit])
            over = before - at(relief, u[hit] + du[hit] * before, v[hit] + dv[hit] * before)
            share = over / np.maximum(over - gap[hit], 1e-12)
            found[rays[hit]] = before - (before - level[hit]) * share
        # Above the highest texel around there is nothing to meet.
        clear = np.floor(
            (level - np.take(peaks, nearest(relief, uu, vv))) / np.maximum(step, 1e-30)
        )
        index += np.clip(clear - 1.0, 1.0, near)
        keep = np.flatnonzero(~below & (index <= count))
        if len(keep) < len(rays):
            rays, index, count = rays[keep], index[keep], count[keep]
            step, near = step[keep], near[keep]
            u, v, du, dv = u[keep], v[keep], du[keep], dv[keep]
    return found
