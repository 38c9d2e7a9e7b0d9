"""Shadow rays of many pixels side by side, plainly: what matcap.relight.loops is held to."""

import numpy as np

from matcap.relight.camera import Array, Vec
from matcap.relight.relief import Relief

# How far above the surface a ray must start, as a share of the relief, against rounding.
_LIFT = 2e-6


def lit(
    relief: Relief, place: tuple[Array, Array], height: Array, to_light: Vec, distance: Array | None
) -> Array:
    """Whether light arrives, for each pixel of a block.

    Args:
        relief: the height field.
        place: (u, v) in plane units, and
        height: the surface there.
        to_light: unit vectors in the material's frame.
        distance: to the light; None when it is infinitely far.
    """
    u, v, h, x, y, z = (a.astype(float) for a in np.broadcast_arrays(*place, height, *to_light))
    h += _LIFT * (relief.high - relief.low)
    column, row = relief.texels(u, v)
    rise = np.maximum(z * relief.texel_size, 1e-12)
    reach = (relief.high - h) / rise
    if distance is not None:
        reach = np.minimum(reach, distance / relief.texel_size)
    width, rows = relief.texture.size
    field = relief.heights.reshape(rows, width)
    hidden = _crossed(field, (x, -y), (column, row), h, rise, reach)
    hidden |= _crossed(field.T, (-y, x), (row, column), h, rise, reach)
    return (z > 0.0) & ~hidden


def _crossed(
    field: Array,
    direction: tuple[Array, Array],
    start: tuple[Array, Array],
    height: Array,
    rise: Array,
    reach: Array,
) -> Array:
    """Which rays pass below the surface on one of the lines along the field's columns.

    direction, start: across these lines, and along them.
    """
    across, along = direction
    forward, pace = np.sign(across), 1.0 / np.maximum(np.abs(across), 1e-9)
    line = np.where(forward > 0, np.floor(start[0]) + 1.0, np.ceil(start[0]) - 1.0)
    # How far along the ray the next line is.
    track = np.abs(line - start[0]) * pace
    hidden = np.zeros(height.shape, dtype=bool)
    while (going := ~hidden & (np.abs(across) > 1e-9) & (track < reach)).any():
        cross = start[1] + along * track
        low = np.floor(cross)
        share = (cross - low).astype(np.float32)
        column, row = np.mod(line, field.shape[1]).astype(int), np.mod(low, len(field)).astype(int)
        here, beside = field[row, column], field[(row + 1) % len(field), column]
        hidden |= going & (here + share * (beside - here) > height + rise * track)
        line, track = line + forward, track + pace
    return hidden
