"""Mip moments [olano2010] of the endless field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from matcap.example.coordinates import Places
from matcap.example.example import Example, coarse_places, detail_bits, halved
from matcap.example.exemplar import Exemplar
from matcap.example.library import draw, hash_places
from matcap.field.field import Field
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.field.source import Source

# Moments: quantities whose averages are the mip levels of a material [olano2010].
#
# Nine planes, float32: diffuse albedo (3), F0 (1), alpha^2, slopes along x and y, the sum of
# squared slopes, height; eleven where F0 has three channels. All are linear under averaging, as in
# relight/texture.py: the variance of slopes within a coarse texel adds to its alpha^2.

Planes = NDArray[np.float32]

DIFFUSE, F0 = slice(0, 3), slice(3, -5)
ALBEDO = slice(0, -5)  # diffuse and F0
ALPHA2, SLOPE_X, SLOPE_Y, SQUARES, HEIGHT = -5, -4, -3, -2, -1
RING = 1  # texels around maps, for central differences
_LEAST_ROUGHNESS = np.float32(1e-3)  # as in brdf/cook_torrance.py


def moments_of(stacked: Planes, texel_size: float) -> Planes:
    """(9 or 11, H, W) moments of stacked maps (6 or 8, H + 2 RING, W + 2 RING).

    Slopes are central differences.
    """
    *_, roughness, height = stacked
    inner = stacked[:, RING:-RING, RING:-RING]
    step = np.float32(0.5 / texel_size)
    moments = np.empty((len(stacked) + 3, *inner.shape[1:]), np.float32)
    moments[ALBEDO] = inner[:-2]
    rough = np.maximum(roughness[RING:-RING, RING:-RING], _LEAST_ROUGHNESS)
    moments[ALPHA2] = np.square(np.square(rough))
    moments[SLOPE_X] = (height[RING:-RING, 2 * RING :] - height[RING:-RING, : -2 * RING]) * step
    moments[SLOPE_Y] = (height[: -2 * RING, RING:-RING] - height[2 * RING :, RING:-RING]) * step
    moments[SQUARES] = np.square(moments[SLOPE_X]) + np.square(moments[SLOPE_Y])
    moments[HEIGHT] = inner[-1]
    return moments


def edged(stacked: Planes) -> Planes:
    """Pad stacked maps by RING texels so that slopes at the borders are one-sided differences."""
    grown = np.pad(stacked, ((0, 0), (RING, RING), (RING, RING)), mode="edge")
    height = grown[-1]
    height[0], height[-1] = 2 * height[1] - height[2], 2 * height[-2] - height[-3]
    height[:, 0] = 2 * height[:, 1] - height[:, 2]
    height[:, -1] = 2 * height[:, -2] - height[:, -3]
    return grown


def mean_of(moments: Planes) -> tuple[float, ...]:
    """Mean of each plane."""
    return tuple(float(one) for one in moments.mean(axis=(1, 2), dtype=np.float64))


# Mip moments [olano2010] of the endless field: means over squares of 2^level texels.
#
# Fine levels are averages of synthesised texels. Coarse levels would need too many texels:
#
# - by example they are averages of the exemplar, at places that are synthesised at that level;
# - of a network they are blended from a periodic tile of its field at random shifts [deliot2019].

_NEAR = 1  # coarsest level that is averaged from synthesised texels; coarser ones take too long
_PIECE = 7  # squares from 2^7 texels on are in different patches, and independent
_TILE = 256  # texels a side of a network's periodic tile


class Pyramid:
    """All mip levels of periodic moments (9 or 11, H, W)."""

    def __init__(self, moments: Planes) -> None:
        self._levels = [moments]

    def read(self, level: int, area: Rectangle) -> Planes:
        """(9 or 11, height, width) moments of an area, in texels of a level."""
        while len(self._levels) <= level:
            finest = self._levels[-1]
            # An odd side is doubled, so that it can be halved.
            repeats = (1, *(1 + size % 2 for size in finest.shape[1:]))
            self._levels.append(halved(np.tile(finest, repeats)))
        planes = self._levels[level]
        rows = np.arange(area.y, area.y + area.height) % planes.shape[1]
        columns = np.arange(area.x, area.x + area.width) % planes.shape[2]
        return planes[:, rows[:, None], columns]


@dataclass(frozen=True)
class ExampleLevels:
    """Mip levels of the field by example of a seed."""

    example: Example
    seed: int
    averages: Callable[[], ExemplarAverages]
    """Returns the averages of the exemplar, computed once for all seeds."""

    @property
    def texel_size(self) -> float:
        """Side of a texel, plane units."""
        return self.example.exemplar.texel_size

    def read(self, level: int, area: Rectangle) -> Planes:
        """(9 or 11, height, width) moments of an area, in texels of a level."""
        if level <= max(_NEAR, detail_bits(self.example.exemplar)):
            stacked = self.example.maps(self.seed, _finest(level, area).grown(RING), None)
            return _coarser(moments_of(stacked, self.texel_size), level)
        places = coarse_places(self.example, self.seed, level, area)
        return self.averages().read(level, places)


class ExemplarAverages:
    """Averages of an exemplar's moments over squares at any position, by a summed-area table."""

    def __init__(self, exemplar: Exemplar) -> None:
        moments = moments_of(edged(exemplar.stacked()), exemplar.texel_size)
        self._mean = moments.mean(axis=(1, 2), dtype=np.float64).astype(np.float32)[:, None, None]
        self._most = min(_PIECE, min(moments.shape[1:]).bit_length() - 1)
        padded = np.pad(moments, ((0, 0), (1, 0), (1, 0)))
        self._sums = padded.cumsum(axis=1, dtype=np.float64).cumsum(axis=2)
        self._means = lru_cache(maxsize=None)(self._of)

    def read(self, level: int, places: Places) -> Planes:
        """(9 or 11, H, W) averages over squares of 2^level texels at places (H, W, 2)."""
        x, y = places[..., 0], places[..., 1]
        bits = min(level, self._most)
        stride, means = self._means(bits)
        rows = np.minimum(y // stride, means.shape[1] - 1)
        averaged = means[:, rows, np.minimum(x // stride, means.shape[2] - 1)]
        if level > bits:
            # The mean of n independent squares deviates sqrt(n) times less.
            averaged = self._mean + (averaged - self._mean) * np.float32(2.0 ** (bits - level))
        return averaged

    def _of(self, bits: int) -> tuple[int, Planes]:
        """Stride, a quarter of 2^bits texels, and averages of the squares at its multiples."""
        side, stride = 1 << bits, 1 << max(bits - 2, 0)
        right, below = self._sums[..., side::stride], self._sums[:, side::stride]
        rows, columns = below.shape[1], right.shape[2]
        corners = self._sums[:, ::stride, ::stride]
        offset = side // stride
        total = (
            corners[:, offset : offset + rows, offset : offset + columns]
            - corners[:, :rows, offset : offset + columns]
            - corners[:, offset : offset + rows, :columns]
            + corners[:, :rows, :columns]
        )
        return stride, (total / side**2).astype(np.float32)


@dataclass(frozen=True)
class NetworkLevels:
    """Mip levels of the field of a material's network, of a seed."""

    source: Source
    material: Material
    seed: int

    @staticmethod
    def of(material: Material, seed: int) -> NetworkLevels:
        """Open the field.

        Raises:
            UsageError: the seed is out of range.
        """
        return NetworkLevels(Field(material, seed).source, material, seed)

    @property
    def texel_size(self) -> float:
        """Side of a texel, plane units."""
        return self.source.texel_size

    def read(self, level: int, area: Rectangle) -> Planes:
        """(9, height, width) moments of an area, in texels of a level."""
        if level > _NEAR:
            return self._mixed(level, area)
        wanted = _finest(level, area)
        block = _aligned(wanted, self.material.alignment)
        stacked = self.source.maps(block).numpy()
        x, y = wanted.x - block.x, wanted.y - block.y
        cut = stacked[:, y : y + wanted.height + 2 * RING, x : x + wanted.width + 2 * RING]
        return _coarser(moments_of(cut, self.texel_size), level)

    @cached_property
    def _tile(self) -> Pyramid:
        """Moments of a periodic field of _TILE texels."""
        source = Field(self.material, self.seed, (_TILE, _TILE)).source
        stacked = source.maps(Rectangle(0, 0, _TILE, _TILE)).numpy()
        return Pyramid(moments_of(stacked, self.texel_size))

    @property
    def mean(self) -> Planes:
        """(9, 1, 1) moments of the whole tile."""
        return self._tile.read(_TILE.bit_length() - 1, Rectangle(0, 0, 1, 1))

    def _mixed(self, level: int, area: Rectangle) -> Planes:
        """Blend four randomly shifted tiles, keeping mean and variance [deliot2019].

        mean + sum w (tile - mean) / sqrt(sum w^2), without the paper's histogram transformation.
        """
        # Of at least 8 texels a side.
        seen = min(level, _TILE.bit_length() - 4)
        mean = self.mean
        size = _TILE >> seen
        columns, along_x = _cells(area.x, area.width, size)
        rows, along_y = _cells(area.y, area.height, size)
        whole = self._tile.read(seen, Rectangle(0, 0, size, size))
        x, y = np.arange(area.x, area.x + area.width), np.arange(area.y, area.y + area.height)
        total = np.zeros((len(whole), area.height, area.width), np.float32)
        squares = np.zeros((area.height, area.width), np.float32)
        for right in (0, 1):
            for below in (0, 1):
                weight = (along_y if below else 1 - along_y)[:, None] * (
                    along_x if right else 1 - along_x
                )
                hashes = hash_places(self.seed, level, columns + right, (rows + below)[:, None])
                shift_x, shift_y = draw(hashes, 0, size), draw(hashes, 1, size)
                piece = whole[:, (y[:, None] + shift_y) % size, (x + shift_x) % size]
                total += weight.astype(np.float32) * (piece - mean)
                squares += np.square(weight, dtype=np.float32)
        shrunk = np.float32(2.0 ** (seen - level))
        mixed: Planes = np.asarray(mean + total * (shrunk / np.sqrt(squares)), np.float32)
        for part in (mixed[:SLOPE_X], mixed[SQUARES]):
            np.maximum(part, np.float32(1e-9), out=part)
        return mixed


def _cells(start: int, count: int, size: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """For texels from `start` on, the cell of `size` texels, and a smoothstep weight within it."""
    place = np.arange(start, start + count)
    cell = place // size
    along = (place - cell * size + 0.5) / size
    return cell, along * along * (3.0 - 2.0 * along)


def _finest(level: int, area: Rectangle) -> Rectangle:
    """An area in texels of a level, in texels of level 0."""
    return Rectangle(area.x << level, area.y << level, area.width << level, area.height << level)


def _aligned(area: Rectangle, step: int) -> Rectangle:
    """The area extended to multiples of `step` texels."""
    x, y = area.x // step * step, area.y // step * step
    right = -(-(area.x + area.width) // step) * step
    below = -(-(area.y + area.height) // step) * step
    return Rectangle(x, y, right - x, below - y)


def _coarser(moments: Planes, level: int) -> Planes:
    for _ in range(level):
        moments = halved(moments)
    return moments
