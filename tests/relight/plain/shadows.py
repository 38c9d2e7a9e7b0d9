"""Shadow rays of many pixels side by side, plainly: what matcap.relight.loops is held to."""

from __future__ import annotations

import numpy as np

from matcap.relight.relief import Relief
from matcap.relight.vectors import Array, Vec

# Steps of compaction: rays that are done are dropped every so many crossings.
_COMPACT = 4
# How far above the surface a ray must start, as a share of the relief, against rounding.
_LIFT = 2e-6


def lit(
    relief: Relief,
    place: tuple[Array, Array],
    height: Array,
    to_light: Vec,
    distance: Array | None,
) -> Array:
    """Whether light arrives, for each pixel of a block.

    Args:
        relief: the height field.
        place: (u, v) in plane units, and
        height: the surface there.
        to_light: unit vectors in the material's frame.
        distance: to the light; None when it is infinitely far.
    """
    shape = np.broadcast_shapes(*(a.shape for a in (*place, height, *to_light)))
    u, v, h, x, y, z = (np.broadcast_to(a, shape).ravel() for a in (*place, height, *to_light))
    result = z > 0.0
    index = np.flatnonzero(result)
    far = None if distance is None else np.broadcast_to(distance, shape).ravel()[index]
    h = h[index].astype(np.float64) + _LIFT * (relief.high - relief.low)
    column, row = relief.texels(u[index], v[index])
    rise = z[index].astype(np.float64) * relief.texel_size
    reach = (relief.high - h) / rise
    if far is not None:
        reach = np.minimum(reach, far / relief.texel_size)
    across, down = x[index].astype(np.float64), -y[index].astype(np.float64)
    width, height_texels = relief.texture.size
    for major, minor, start, other, size, stride in (
        (across, down, column, row, (width, height_texels), (1, width)),
        (down, across, row, column, (height_texels, width), (width, 1)),
    ):
        hidden = _crossed(relief.heights, major, minor, start, other, h, rise, reach, size, stride)
        result[index[hidden]] = False
    return result.reshape(shape)


def _crossed(
    heights: Array,
    major: Array,
    minor: Array,
    start: Array,
    other: Array,
    height: Array,
    rise: Array,
    reach: Array,
    size: tuple[int, int],
    stride: tuple[int, int],
) -> Array:
    """Which rays pass below the surface on one of the grid's lines across `major`."""
    hidden = np.zeros(len(major), dtype=bool)
    moving = np.abs(major) > 1e-9
    forward = np.sign(major)
    # The next line, a whole number, and how far along the ray it and each further one is.
    first = np.where(forward > 0, np.floor(start) + 1.0, np.ceil(start) - 1.0)
    pace = 1.0 / np.maximum(np.abs(major), 1e-9)
    along = np.abs(first - start) * pace
    active = np.flatnonzero(moving & (along < reach))
    step = 0
    line, track = first[active], along[active]
    f, p, mi, o, h, ri, re = (a[active] for a in (forward, pace, minor, other, height, rise, reach))
    while len(active):
        cross = o + mi * track
        low = np.floor(cross)
        share = (cross - low).astype(np.float32)
        at = np.mod(line.astype(np.int64), size[0]) * stride[0]
        j0 = np.mod(low.astype(np.int64), size[1])
        j1 = np.where(j0 + 1 == size[1], 0, j0 + 1)
        z0 = heights[at + j0 * stride[1]]
        surface = z0 + share * (heights[at + j1 * stride[1]] - z0)
        within = track < re
        struck = (surface > h + ri * track) & within
        hidden[active[struck]] = True
        line, track = line + f, track + p
        step += 1
        if step % _COMPACT == 0:
            keep = within & ~struck
            active, line, track = active[keep], line[keep], track[keep]
            f, p, mi, o, h, ri, re = (a[keep] for a in (f, p, mi, o, h, ri, re))
    return hidden
