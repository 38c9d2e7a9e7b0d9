"""Horizons of all texels by whole maps, plainly: what matcap.relight.loops is held to."""

import math
from dataclasses import dataclass

import numpy as np

from matcap.relight.camera import Array
from matcap.relight.relief import Relief, steps_of

AZIMUTHS = 16


@dataclass(frozen=True)
class Horizons:
    """For each texel, row by row."""

    tangents: Array
    """(H W, AZIMUTHS) tangent of the horizon's elevation, azimuth 0 along x, turning towards y."""
    open: Array
    """(H W, 1) share of the light of an even sky that arrives, of what arrives above the plane on
    the same slope."""
    bounced: Array
    """(H W, 9) for each colour, the vector t such that a neighbourhood lit by irradiance e along l
    sends the texel t . (e l), when none of it faces away from l."""


def find_horizons(relief: Relief) -> Horizons:
    """The horizons of a relief that repeats."""
    width, height = relief.texture.size
    field = relief.heights.reshape(height, width) / np.float32(relief.texel_size)
    steps = steps_of(float(field.max() - field.min()))
    reach = max(steps)
    # Enough of the material's repetition all around.
    padded = np.pad(field, reach, mode="wrap")
    slope_x = 0.5 * (np.roll(field, -1, 1) - np.roll(field, 1, 1))
    slope_y = 0.5 * (np.roll(field, 1, 0) - np.roll(field, -1, 0))
    nz = 1.0 / np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    # What each texel reflects of light along x, y and z, albedo / pi times an azimuth's width.
    lit = np.stack([
        np.pad(albedo * component * np.float32(2.0 / AZIMUTHS), reach, mode="wrap")
        for albedo in relief.texture.diffuse
        for component in (-slope_x * nz, -slope_y * nz, nz)
    ])  # fmt: skip
    tangents, seen = [], np.zeros_like(field)
    bounced = np.zeros((9, height, width), dtype=np.float32)
    for azimuth in range(AZIMUTHS):
        angle = 2.0 * math.pi * azimuth / AZIMUTHS
        c, s = math.cos(angle), math.sin(angle)
        # In units of nz: n . (c, s, 0), and the slope at which the surface itself ends.
        level = np.float32(c) * slope_x + np.float32(s) * slope_y
        side = -level * nz
        weight = strip(level, side, nz)
        for step in steps:
            across, down = round(step * c), -round(step * s)
            window = (
                slice(reach + down, reach + down + height),
                slice(reach + across, reach + across + width),
            )
            rise = (padded[window] - field) * np.float32(1.0 / math.hypot(across, down))
            level = np.maximum(level, rise)
            higher = strip(level, side, nz)
            bounced += (higher - weight) * lit[:, *window]
            weight = higher
        tangents.append(level)
        above = strip(np.maximum(level, np.float32(0.0)), side, nz)
        seen += side * np.float32(math.pi / 4.0) + nz * np.float32(0.5) - above
    # Of an even sky of radiance 1, what arrives, against what a slope alone lets through.
    seen *= np.float32(2.0 * math.pi / AZIMUTHS)
    clear = np.clip(seen / (np.float32(math.pi / 2.0) * (1.0 + nz)), 0.0, 1.0)
    return Horizons(
        np.stack(tangents, axis=-1).reshape(-1, AZIMUTHS),
        clear.reshape(-1, 1),
        bounced.reshape(9, -1).T,
    )


def strip(tangent: Array, side: Array, nz: Array) -> Array:
    """Integral of n . w cos(e) over elevations e from 0 to that of the tangent, at one azimuth.

    `side` is n . (the azimuth's direction).
    """
    squared = tangent * tangent
    share = 1.0 / (1.0 + squared)
    return np.float32(0.5) * (side * (np.arctan(tangent) + tangent * share) + nz * squared * share)
