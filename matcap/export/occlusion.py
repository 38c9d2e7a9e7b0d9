"""Ambient occlusion, cavity and bent normals of a height field, from horizon maps [max1988]."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

# From each texel the height field is sampled along AZIMUTHS directions in growing steps; the
# highest elevation is the horizon. Visibility and mean direction above it are closed-form integrals
# over the elevation e, from the horizon to the zenith, with direction w:
#
# open = 1/pi  sum over azimuths  width integral of (n.w) cos(e) de
# bent ~       sum over azimuths  width integral of (n.w) w cos(e) de
#
# Directions below the horizontal are occluded. Heights are averaged over the length of a step, so
# that a ridge between two steps is lowered instead of missed. Cavity is `open` with horizons within
# CAVITY_REACH texels. relight/relief.py is the renderer's version, with interreflection.

Picture = NDArray[np.float32]
AZIMUTHS = 12
REACH = 256  # texels
CAVITY_REACH = 4
LARGEST = 2048 * 2048  # texels: larger fields are computed at half resolution
_THREADS = 2
_LOWEST = math.tan(math.radians(2.0))  # walks end where relief could hide less than this
_ROWS = 32  # rows processed together, for the cache


@dataclass(frozen=True)
class Occlusion:
    """Maps of visibility."""

    open: Picture
    """(H, W) irradiance of a uniform sky over that without occlusion, [0, 1]."""
    cavity: Picture
    """(H, W) that irradiance with only occluders within CAVITY_REACH texels, [0, 1]."""
    bent: Picture
    """(H, W, 3) mean unoccluded direction, unit vectors, +Y up."""
    size: tuple[int, int] | None = None
    """(width, height) of the height field, if the maps have half its resolution."""

    def whole(self, kind: str) -> Picture:
        """A map by its name, at the resolution of the height field."""
        values: Picture = getattr(self, kind)
        if self.size is None:
            return values
        return np.asarray(cv2.resize(values, self.size), dtype=np.float32)


def settings(width: int, height: int) -> dict[str, Any]:
    """The sidecar's entry: parameters of the computation."""
    texel = 2 if halved(width, height) else 1
    return {
        "azimuths": AZIMUTHS,
        "reach": texel * REACH,
        "cavity_reach": texel * CAVITY_REACH,
        "unit": "texel",
    }


def occlusion(height: Picture, *, periodic: bool) -> Occlusion:
    """Compute the occlusion of a height field; of a large one at half its resolution.

    Args:
        height: (H, W) in texels, row 0 at the top.
        periodic: it repeats; otherwise border heights are continued.
    """
    if not halved(height.shape[1], height.shape[0]):
        return _occlusion(height, periodic=periodic)
    size = height.shape[1], height.shape[0]
    half = cv2.resize(height, (size[0] // 2, size[1] // 2), interpolation=cv2.INTER_AREA)
    return replace(_occlusion(0.5 * half, periodic=periodic), size=size)


def halved(width: int, height: int) -> bool:
    """Whether a map set of this size is computed at half its resolution."""
    return width * height > LARGEST


def _occlusion(height: Picture, *, periodic: bool) -> Occlusion:
    rows, columns = height.shape
    field = np.ascontiguousarray(height, dtype=np.float32)
    steps = _steps(float(field.max() - field.min()))
    reach = max(steps) + 1
    smooth = _smoothed(field, steps, reach, periodic=periodic)
    out = [np.empty((rows, columns), np.float32) for _ in range(2)]
    bent = np.empty((rows, columns, 3), np.float32)

    def fill(top: int) -> None:
        band = slice(top, min(top + _ROWS, rows))
        made = _band(smooth, steps, reach, band, columns)
        out[0][band], out[1][band] = made[0].numpy(), made[1].numpy()
        bent[band] = made[2].movedim(0, -1).numpy()

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(fill, range(0, rows, _ROWS)))
    return Occlusion(out[0], out[1], bent)


def _steps(rise: float) -> dict[int, int]:
    """Distances of the steps, and the side over which heights are averaged there, in texels."""
    last = min(max(1.0, rise / _LOWEST), REACH)
    steps, step = {}, 1
    while step <= last:
        steps[step] = next(side for side in (27, 9, 3, 1) if 4 * side <= step or side == 1)
        step = max(step + 1, round(step * 1.5))
    return steps or {1: 1}


def _smoothed(
    field: Picture, steps: dict[int, int], reach: int, *, periodic: bool
) -> dict[int, Tensor]:
    """The padded field, averaged over each side in `steps`, by side."""
    wide = np.pad(field, reach + max(steps.values()) // 2, mode="wrap" if periodic else "edge")
    inner = slice(max(steps.values()) // 2, wide.shape[0] - max(steps.values()) // 2)
    across = slice(inner.start, wide.shape[1] - inner.start)
    return {
        side: torch.from_numpy(cv2.blur(wide, (side, side))[inner, across])
        for side in {1, *steps.values()}
    }


def _band(
    smooth: dict[int, Tensor], steps: dict[int, int], reach: int, band: slice, columns: int
) -> tuple[Tensor, Tensor, Tensor]:
    """(open, cavity, bent) of some rows."""
    plain = smooth[1]

    def shifted(field: Tensor, across: int, down: int) -> Tensor:
        return field[
            reach + band.start + down : reach + band.stop + down,
            reach + across : reach + across + columns,
        ]

    own = shifted(plain, 0, 0)
    slope_x = 0.5 * (shifted(plain, 1, 0) - shifted(plain, -1, 0))
    slope_y = 0.5 * (shifted(plain, 0, -1) - shifted(plain, 0, 1))
    nz = torch.rsqrt(1.0 + slope_x.square() + slope_y.square())
    opened, cavity = torch.zeros_like(own), torch.zeros_like(own)
    bent, rise = torch.zeros(3, *own.shape), torch.empty_like(own)
    for azimuth in range(AZIMUTHS):
        # Offset by half a step: no azimuth lies along rows or columns.
        angle = 2.0 * math.pi * (azimuth + 0.5) / AZIMUTHS
        c, s = math.cos(angle), math.sin(angle)
        tangent = (c * slope_x + s * slope_y).clamp_min(0.0)
        side = -(c * slope_x + s * slope_y) * nz
        near = tangent
        for step, wide in steps.items():
            across, down = round(step * c), -round(step * s)
            torch.sub(shifted(smooth[wide], across, down), own, out=rise)
            rise *= 1.0 / math.hypot(across, down)
            torch.maximum(tangent, rise, out=tangent)
            if step == CAVITY_REACH:
                near = tangent.clone()
        cavity += _share(near, side, nz)
        opened += _share(tangent, side, nz)
        cosine = torch.rsqrt(1.0 + tangent.square())
        sine = tangent * cosine
        level = side * (2.0 / 3.0 - sine + sine**3 / 3.0) + nz * cosine**3 / 3.0
        bent[0] += c * level
        bent[1] += s * level
        bent[2] += side * cosine**3 / 3.0 + nz * (1.0 - sine**3) / 3.0
    bent /= torch.linalg.vector_norm(bent, dim=0).clamp_min(1e-9)
    scale = 2.0 / AZIMUTHS  # width of an azimuth, 2 pi / AZIMUTHS, over pi
    return (opened * scale).clamp(0.0, 1.0), (cavity * scale).clamp(0.0, 1.0), bent


def _share(tangent: Tensor, side: Tensor, nz: Tensor) -> Tensor:
    """Irradiance per azimuth of a uniform sky above the horizon, for a unit normal n.

    With w = (cos e, sin e) in the vertical plane of the azimuth and n.w = side cos e + nz sin e,
    the integral of (n.w) cos(e) de from e = atan(tangent) to pi/2, 0 where negative.
    """
    below = 1.0 / (1.0 + tangent.square())
    left = side * (math.pi / 2.0 - torch.atan(tangent) - tangent * below)
    share: Tensor = 0.5 * (left + nz * below)
    return share.clamp_min(0.0)
