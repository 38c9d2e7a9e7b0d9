"""Decode normal maps of other programs, and determine which way their green points."""

from __future__ import annotations

import numpy as np

from matcap.brdf.stated import NormalStyle
from matcap.errors import MatcapError
from matcap.files.pixels import Pixels
from matcap.relight.vectors import Array

_STEEPEST = 20.0  # largest slope that 8 bits resolve
_STEP = 2.0 / 255.0  # range below which a channel is constant
_UNIT = 0.05  # largest mean deviation of vectors' length from 1
_NEGATIVE = 0.01  # largest share of negative texels in a map stored as 0.5 + 0.5 n
_FACING_DOWN = 0.5  # largest share of normals with z <= 0
_CLEARLY = 0.9  # ratio of the curls above which the test is undecided
_SAMPLE = 1_000_000  # texels from which a map's encoding is determined


def slopes_of(pixels: Pixels) -> tuple[Array, tuple[str, ...]]:
    """(2, H, W) dh/dx and dh/dy of a normal map, y along its green; and notes.

    Integers are 0.5 + 0.5 n. Floats are that or n itself, whichever gives vectors of length 1. If
    blue is missing or constant, z = sqrt(1 - x^2 - y^2). If red is constant and alpha is not, x is
    in alpha (DXT5nm compression).

    Raises:
        MatcapError: a single channel, or most vectors have z <= 0.
    """
    name = pixels.path.name
    if pixels.grey:
        raise MatcapError.at(
            pixels.path,
            "has one channel, and a normal map needs two",
            "remove it, or name it as height if that is what it is",
        )
    x, y = pixels.channel("R"), pixels.channel("G")
    z = pixels.channel("B") if "B" in pixels.roles else None
    notes = []
    if "A" in pixels.roles and _constant(x) and not _constant(y):
        alpha = pixels.channel("A")
        if not _constant(alpha):
            x, z = alpha, None
            notes.append(f"{name}: x is taken from alpha, y from green")
    if pixels.whole or _coded(x, y, z):
        x, y = 2.0 * x - 1.0, 2.0 * y - 1.0
        z = None if z is None else 2.0 * z - 1.0
    if z is not None and _constant(z) and not (_constant(x) and _constant(y)):
        unit = np.abs(np.sqrt(x * x + y * y + z * z) - 1.0).mean() < _UNIT
        z = z if unit and float(z.flat[0]) > 0.0 else None
    if z is None:
        notes.append(f"{name}: z is computed from x and y")
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
    facing_down = float((z <= 0.0).mean())
    if facing_down > _FACING_DOWN:
        raise MatcapError.at(
            pixels.path,
            f"{facing_down:.0%} of its normals point away from the surface",
            "bake it in tangent space",
        )
    if facing_down > 1e-3:
        notes.append(
            f"{name}: {facing_down:.1%} of its normals point away from the viewer; "
            f"their slope is limited to {_STEEPEST:g}"
        )
    z = np.maximum(z, 1.0 / _STEEPEST)
    slopes = np.stack([-x / z, -y / z])
    # Limit the slope also where x and y are too large for a unit vector.
    length = np.sqrt((slopes * slopes).sum(0))
    return slopes * np.minimum(1.0, _STEEPEST / np.maximum(length, 1e-9)), tuple(notes)


def looks_like_normals(pixels: Pixels) -> bool:
    """Whether a picture's median colour is that of a normal map: bluish, of length 1."""
    if pixels.grey or not pixels.whole or "B" not in pixels.roles:
        return False
    n = [2.0 * _sample(pixels.channel(role)) - 1.0 for role in ("R", "G", "B")]
    length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    x, y, z, unit = (float(np.median(one)) for one in (*n, length))
    return z > 0.5 and max(abs(x), abs(y)) < 0.2 and abs(unit - 1.0) < 0.1


def style_of(slopes: Array, rise: Array | None, usual: NormalStyle) -> NormalStyle:
    """Determine which way green points: "gl" up, "dx" down.

    By correlation with the height map's slopes; without one by the curl, which is 0 for the
    gradient of a surface. Reliefs f(x) + g(y) have no curl either way: then `usual`.

    Args:
        slopes: (2, H, W) dh/dx, and dh/dy along green.
        rise: (2, H, W) slopes of the height map, y up; None without one.
        usual: direction that the files' naming suggests.
    """
    if rise is not None and (rise[1] * slopes[1]).any():
        return "gl" if (rise[1] * slopes[1]).sum() >= 0.0 else "dx"

    def curl(sign: float) -> float:
        # d(dh/dx)/dy - d(dh/dy)/dx; rows run downwards.
        twist = np.roll(slopes[0], 1, 0) - np.roll(slopes[0], -1, 0)
        twist = twist - sign * (np.roll(slopes[1], -1, 1) - np.roll(slopes[1], 1, 1))
        return float((twist * twist).mean())

    up, down = curl(1.0), curl(-1.0)
    if min(up, down) >= _CLEARLY * max(up, down):
        return usual
    return "gl" if up < down else "dx"


def gradient(height: Array, texel: float) -> Array:
    """(2, H, W) dh/dx and dh/dy of a repeating height (1, H, W), y up: central differences."""
    field = height[0]
    across = (np.roll(field, -1, 1) - np.roll(field, 1, 1)) / (2.0 * texel)
    up = (np.roll(field, 1, 0) - np.roll(field, -1, 0)) / (2.0 * texel)
    return np.stack([across, up])


def _coded(x: Array, y: Array, z: Array | None) -> bool:
    """Whether floats are 0.5 + 0.5 n rather than n, by the median texel."""
    if z is None:
        return bool(max(float((one < 0.0).mean()) for one in (x, y)) < _NEGATIVE)
    n = np.stack([_sample(one) for one in (x, y, z)])
    plain, coded = (
        float(np.median(np.abs(np.sqrt((one * one).sum(0)) - 1.0))) for one in (n, 2.0 * n - 1.0)
    )
    return coded < plain


def _sample(plane: Array) -> Array:
    return plane.reshape(-1)[:: max(1, plane.size // _SAMPLE)]


def _constant(plane: Array) -> bool:
    return bool(float(plane.max()) - float(plane.min()) < _STEP)
