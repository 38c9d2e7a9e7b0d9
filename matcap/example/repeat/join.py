"""Maps of a seamless tile by gradient-domain blending: a Poisson equation on a torus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import Floats

# The seamless tile; docs/notes/field.md.
_BLUR = 6.0  # texels over which the step at a seam is spread. Less shows the seam, more a halo.

TileTexels = NDArray[np.int64]


def joined(maps: Floats, x: TileTexels, y: TileTexels) -> Floats:
    """(6 or 8, h, w) seamless stacked maps.

    Height minimises sum |grad h - g|^2 on the torus, g the exemplar's differences between texels;
    this removes its mean slope. The other maps minimise the same plus sum (m - shown)^2 / blur^2,
    which spreads the step at a seam over about _BLUR texels.

    Args:
        maps: stacked, of the exemplar.
        x, y: (h, w) texels of the exemplar that the tile shows.
    """
    planes = np.stack([_closed(plane, x, y, _BLUR) for plane in maps[:-1]])
    np.clip(planes, 0.0, 1.0, out=planes)
    return np.concatenate([planes, _closed(maps[-1], x, y, None)[None]])


def is_cut(x: TileTexels, y: TileTexels) -> NDArray[np.bool_]:
    """(h, w) whether a seam lies between a texel and the one right of it or below."""
    return ~(_follows(x, y, 1) & _follows(x, y, 0))


def _closed(plane: Floats, x: TileTexels, y: TileTexels, blur: float | None) -> Floats:
    """Solve for one map by FFT; with `blur` None its mean is kept."""
    shown = plane[y, x].astype(np.float64)
    divergence = np.zeros_like(shown)
    for axis in (1, 0):
        step = _steps(plane, shown, x, y, axis)
        divergence += step - np.roll(step, 1, axis)
    turns = [np.cos(2.0 * np.pi * np.fft.fftfreq(shown.shape[0]))[:, None]]
    turns += [np.cos(2.0 * np.pi * np.fft.rfftfreq(shown.shape[1]))[None, :]]
    laplacian = 4.0 - 2.0 * turns[0] - 2.0 * turns[1]
    screening = 0.0 if blur is None else 1.0 / blur**2
    waves = np.fft.rfft2(screening * shown - divergence)
    if blur is None:
        laplacian[0, 0] = 1.0
        waves[0, 0] = shown.sum()
    return np.fft.irfft2(waves / (laplacian + screening), s=shown.shape).astype(np.float32)


def _steps(
    plane: Floats, shown: NDArray[np.float64], x: TileTexels, y: TileTexels, axis: int
) -> NDArray[np.float64]:
    """(h, w) difference from each texel to the next along an axis.

    Across a seam it is the mean of the differences that the exemplar has on both sides.
    """
    step = np.roll(shown, -1, axis) - shown
    rows, columns = np.nonzero(~_follows(x, y, axis))
    high, wide = plane.shape
    right, down = (1, 0) if axis == 1 else (0, 1)
    here = y[rows, columns], x[rows, columns]
    after = (rows + down) % x.shape[0], (columns + right) % x.shape[1]
    there = y[after], x[after]
    rise, sides = np.zeros(len(rows)), np.zeros(len(rows))
    for (row, column), direction in ((here, 1), (there, -1)):
        other = row + direction * down, column + direction * right
        known = (other[0] >= 0) & (other[0] < high) & (other[1] >= 0) & (other[1] < wide)
        other = other[0].clip(0, high - 1), other[1].clip(0, wide - 1)
        rise += np.where(known, direction * (plane[other] - plane[row, column]), 0.0)
        sides += known
    step[rows, columns] = np.where(sides > 0, rise / np.maximum(sides, 1), step[rows, columns])
    return step


def _follows(x: TileTexels, y: TileTexels, axis: int) -> NDArray[np.bool_]:
    """(h, w) whether the next texel along an axis, on the torus, is the exemplar's next one."""
    right, down = (1, 0) if axis == 1 else (0, 1)
    following = (np.roll(x, -1, axis) - x == right) & (np.roll(y, -1, axis) - y == down)
    return np.asarray(following)
