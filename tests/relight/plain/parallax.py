"""Rays through relief, many side by side, plainly: what matcap.relight.loops is held to."""

import numpy as np

from matcap.relight.camera import Array, Vec
from matcap.relight.relief import Relief
from plain.relief import at


def shift(
    relief: Relief, place: tuple[Array, Array], to_view: Vec
) -> tuple[tuple[Array, Array], Array]:
    """Where rays through `place` on the undisplaced surface meet the displaced one.

    Args:
        relief: the height field.
        place: (u, v) in plane units.
        to_view: unit vectors to the camera in the material's frame.

    Returns:
        (u, v) there and the height there, arrays of the block's shape.
    """
    u, v, x, y, z = np.broadcast_arrays(*place, *to_view)
    # Per unit of height, how far the ray moves on the surface.
    steep = 1.0 / np.maximum(z, np.float32(0.05))
    du, dv = x * steep, y * steep
    span = relief.high - relief.low
    pace = np.hypot(du, dv) * np.float32(span / relief.texel_size)
    count = np.clip(np.ceil(3.0 * pace), 8.0, 512.0)
    step = span / count.astype(np.float64)
    height = np.full(u.shape, relief.low, dtype=np.float32)
    going, index = np.ones(u.shape, dtype=bool), 0
    while going.any():
        level = relief.high - step * index
        gap = level - at(relief, u + du * level, v + dv * level)
        # The crossing of two straight lines between the last two steps.
        before = level + step if index else level
        over = before - at(relief, u + du * before, v + dv * before)
        crossing = before - (before - level) * (over / np.maximum(over - gap, 1e-12))
        height = np.where(going & (gap <= 0.0), crossing, height)
        index += 1
        going &= (gap > 0.0) & (index <= count)
    u, v = u + du * height, v + dv * height
    # The secant ends near the surface; shadows must start on it.
    return (u, v), at(relief, u, v)
