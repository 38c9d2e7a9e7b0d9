"""Horizons of all texels by whole maps, plainly: what matcap.relight.loops is held to.

From every texel, along 16 azimuths, the height field is walked outwards in growing steps (each
texel for the first eight, then a fifth more each time), and the highest elevation so far is kept
(horizon mapping: Max 1988). Whenever it rises, the strip of directions between the old elevation
and the new shows the neighbour: its share of what the texel receives is exact for the strip. A
ridge thinner than the step may be missed; steps stop where the relief could hide less than 3
degrees, and at 256 texels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from matcap.relight.relief import Relief
from matcap.relight.vectors import Array

AZIMUTHS = 16
_FARTHEST = 256
_LOWEST = math.tan(math.radians(3.0))
_ROWS = 32

HorizonMap = Array


@dataclass(frozen=True)
class Horizons:
    """For each texel, row by row.

    Attributes:
        tangents: (H W, AZIMUTHS) tangent of the horizon's elevation, azimuth 0 along x, turning
            towards y.
        open: (H W, 1) share of the light of an even sky that arrives, of what arrives above the
            plane on the same slope.
        bounced: (H W, 9) or None: for each colour, the vector t such that a neighbourhood lit by
            irradiance e along l sends the texel t . (e l), when none of it faces away from l.
    """

    tangents: HorizonMap
    open: HorizonMap
    bounced: HorizonMap | None


Runner = Callable[[Callable[[int], None], Iterable[int]], None]


def find_horizons(relief: Relief, *, bounces: bool, run: Runner) -> Horizons:
    """The horizons of a relief.

    Args:
        relief: the height field.
        bounces: whether to gather what neighbours reflect.
        run: calls a function for each of a range, on as many cores as there are.
    """
    width, height = relief.texture.size
    field = relief.heights.reshape(height, width) / np.float32(relief.texel_size)
    steps = steps_of(float(field.max() - field.min()))
    reach = max(steps)
    # Enough of the material's repetition all around.
    padded = np.pad(field, reach, mode="wrap")
    slope_x, slope_y = slopes(field)
    lit = lit_texels(relief, reach) if bounces else None
    tangents = np.empty((height, width, AZIMUTHS), dtype=np.float32)
    clear = np.empty((height, width), dtype=np.float32)
    bounced = np.zeros((9, height, width), dtype=np.float32) if bounces else None

    def rows(top: int) -> None:
        bottom = min(top + _ROWS, height)
        part = slice(top, bottom)
        own, sx, sy = field[part], slope_x[part], slope_y[part]
        nz = 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)
        seen = np.zeros_like(own)
        for azimuth in range(AZIMUTHS):
            c, s = direction(azimuth)
            # In units of nz: n . (c, s, 0), and the slope at which the surface itself ends.
            level = np.float32(c) * sx + np.float32(s) * sy
            side = -level * nz
            weight = strip(level, side, nz)
            for step in steps:
                across, down = round(step * c), -round(step * s)
                window = (
                    slice(reach + top + down, reach + bottom + down),
                    slice(reach + across, reach + across + width),
                )
                rise = (padded[window] - own) * np.float32(1.0 / math.hypot(across, down))
                if bounced is None or lit is None:
                    np.maximum(level, rise, out=level)
                    continue
                if not (rise > level).any():
                    continue
                np.maximum(level, rise, out=level)
                higher = strip(level, side, nz)
                share = higher - weight
                weight = higher
                for k in range(9):
                    bounced[k, part] += share * lit[k][window]
            tangents[part, :, azimuth] = level
            np.maximum(level, np.float32(0.0), out=level)
            seen += side * np.float32(math.pi / 4.0) + nz * np.float32(0.5) - strip(level, side, nz)
        # Of an even sky of radiance 1, what arrives, against what a slope alone lets through.
        seen *= np.float32(2.0 * math.pi / AZIMUTHS)
        clear[part] = np.clip(seen / (np.float32(math.pi / 2.0) * (1.0 + nz)), 0.0, 1.0)

    run(rows, range(0, height, _ROWS))
    return Horizons(
        tangents.reshape(-1, AZIMUTHS),
        clear.reshape(-1, 1),
        None if bounced is None else np.ascontiguousarray(bounced.reshape(9, -1).T),
    )


def direction(azimuth: int) -> tuple[float, float]:
    """Rightwards and upwards components of an azimuth's unit vector."""
    angle = 2.0 * math.pi * azimuth / AZIMUTHS
    return math.cos(angle), math.sin(angle)


def strip(tangent: HorizonMap, side: HorizonMap, nz: HorizonMap) -> HorizonMap:
    """Integral of n . w cos(e) over elevations e from 0 to that of the tangent, at one azimuth.

    `side` is n . (the azimuth's direction).
    """
    squared = tangent * tangent
    share = 1.0 / (1.0 + squared)
    integral: HorizonMap = np.float32(0.5) * (
        side * (np.arctan(tangent) + tangent * share) + nz * squared * share
    )
    return integral


def slopes(field: HorizonMap) -> tuple[HorizonMap, HorizonMap]:
    """Slopes of a field in texels that repeats, rightwards and upwards."""
    return (
        0.5 * (np.roll(field, -1, 1) - np.roll(field, 1, 1)),
        0.5 * (np.roll(field, 1, 0) - np.roll(field, -1, 0)),
    )


def lit_texels(relief: Relief, reach: int) -> list[HorizonMap]:
    """What each texel reflects of light along x, y and z, a colour after the other, padded."""
    width, height = relief.texture.size
    slope_x, slope_y = slopes(relief.heights.reshape(height, width) / np.float32(relief.texel_size))
    nz = 1.0 / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    # albedo / pi, and the width of an azimuth.
    factor = np.float32(2.0 / AZIMUTHS)
    return [
        np.pad(albedo * component * factor, reach, mode="wrap")
        for albedo in relief.texture.diffuse
        for component in (-slope_x * nz, -slope_y * nz, nz)
    ]


def steps_of(rise: float) -> list[int]:
    """Distances in texels at which the field is looked at; `rise` is its range in texels."""
    last = min(max(1, math.ceil(rise / _LOWEST)), _FARTHEST)
    steps, step = [], 1
    while step <= last:
        steps.append(step)
        step = max(step + 1, round(step * 1.2)) if step >= 8 else step + 1
    return steps or [1]
