"""Reading a texture between its texels; it repeats endlessly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcap.relight.lobes import alpha_of
from matcap.relight.surfaces.hits import some
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array, Vec

# Places this close to texel centres, in texels, are texel centres.
_ALIGNED = 1e-3


@dataclass(frozen=True)
class SurfaceSample:
    """The material at a block of pixels, (rows, W) arrays.

    Attributes:
        diffuse: one array a colour channel.
        specular: one array, or one a colour channel.
        alpha: GGX alpha.
        normal: unit shading normal in the material's frame.
    """

    diffuse: tuple[Array, ...]
    specular: tuple[Array, ...]
    alpha: Array
    normal: Vec

    def take(self, index: Array, shape: tuple[int, ...]) -> SurfaceSample:
        """Some of the pixels of a block of some shape, counted row by row, as one row."""
        x, y, z = (some(one, index, shape) for one in self.normal)
        return SurfaceSample(
            tuple(some(one, index, shape) for one in self.diffuse),
            tuple(some(one, index, shape) for one in self.specular),
            some(self.alpha, index, shape),
            (x, y, z),
        )


@dataclass(frozen=True)
class Sampler:
    """A texture laid on a surface, `repeat` times smaller than it is, its middle at (0, 0)."""

    texture: Texture
    repeat: float

    def texels(self, place: tuple[Array, Array]) -> tuple[Array, Array]:
        """Columns and rows, in texels, of places; texel centres are whole numbers."""
        width, height = self.texture.size
        step = self.repeat / self.texture.texel_size
        return place[0] * step + (width - 1) / 2.0, (height - 1) / 2.0 - place[1] * step

    def read(self, place: tuple[Array, Array], footprint: Array | None = None) -> SurfaceSample:
        """The material at places (u, v) in plane units.

        Args:
            place: on the surface.
            footprint: what each pixel covers there, in plane units, to be averaged over; None
                reads between the nearest texels.
        """
        column, row = self.texels(place)
        wide = None
        if footprint is not None:
            wide = footprint * np.float32(self.repeat / self.texture.texel_size)
        if wide is None:
            aligned = self._aligned(column, row)
            if aligned is not None:
                return aligned
        column, row = np.broadcast_arrays(column, row)
        if wide is None:
            return self._unpacked(bilinear(self._rows, self.texture.size, column, row))
        return self._unpacked(self._trilinear(column, row, np.broadcast_to(wide, column.shape)))

    def extra(self, rows: Array, place: tuple[Array, Array]) -> Array:
        """(C, ...) bilinear values of other numbers (H W, C) of each texel."""
        column, row = np.broadcast_arrays(*self.texels(place))
        return bilinear(rows, self.texture.size, column, row)

    def between(self, rows: Callable[[Array], Array], place: tuple[Array, Array]) -> Array:
        """As extra(), of numbers (N, C) that a function has for a list of texels."""
        texels, index = np.unique(self.corners(place), return_inverse=True)
        column, row = np.broadcast_arrays(*self.texels(place))
        fx, fy = (c - np.floor(c) for c in (column, row))
        weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
        found = rows(texels)[index.reshape(weights.shape)]
        mean: Array = (found * weights[..., None].astype(np.float32)).sum(axis=0)
        return np.moveaxis(mean, -1, 0)

    def corners(self, place: tuple[Array, Array]) -> Array:
        """(4, ...) indices of the texels that extra() reads between."""
        width, height = self.texture.size
        column, row = np.broadcast_arrays(*(np.floor(c) for c in self.texels(place)))
        x = [np.mod(column + step, width).astype(np.intp) for step in (0, 1)]
        y = [np.mod(row + step, height).astype(np.intp) * width for step in (0, 1)]
        return np.stack([y[i] + x[j] for i in (0, 1) for j in (0, 1)])

    def nearest(self, place: tuple[Array, Array]) -> Array:
        """Indices of the texels nearest to places."""
        width, height = self.texture.size
        column, row = np.broadcast_arrays(*self.texels(place))
        x = np.mod(np.rint(column).astype(np.int64), width)
        return np.mod(np.rint(row).astype(np.int64), height) * width + x

    def _aligned(self, column: Array, row: Array) -> SurfaceSample | None:
        """Texels themselves, where places are a grid of neighbouring texel centres."""
        if column.shape[0] != 1 or row.shape[1] != 1:
            return None
        first, top = round(float(column[0, 0])), round(float(row[0, 0]))
        right, below = first + column.shape[1], top + row.shape[0]
        width, height = self.texture.size
        if first < 0 or top < 0 or right > width or below > height:
            return None
        off = max(
            np.abs(column[0] - np.arange(first, right)).max(),
            np.abs(row[:, 0] - np.arange(top, below)).max(),
        )
        if off > _ALIGNED:
            return None
        cut = (slice(None), slice(top, below), slice(first, right))
        maps = self.texture
        return SurfaceSample(
            tuple(maps.diffuse[cut]),
            tuple(maps.specular[cut]),
            self._alpha[cut[1:]],
            tuple(maps.normal[cut]),
        )

    def _unpacked(self, values: Array) -> SurfaceSample:
        split = 3 + len(self.texture.specular)
        squared, x, y, variance = values[split:]
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        alpha = np.sqrt(np.minimum(squared + variance, np.float32(1.0)))
        return SurfaceSample(tuple(values[:3]), tuple(values[3:split]), alpha, (-x * z, -y * z, z))

    @cached_property
    def _alpha(self) -> Array:
        alpha: Array = alpha_of(self.texture.roughness[0])
        return alpha

    @cached_property
    def _rows(self) -> Array:
        """(H W, C) of each texel: diffuse, specular, alpha squared, slopes, their variance."""
        maps = self.texture
        none = np.zeros_like(self._alpha)[None]
        squared = np.square(self._alpha)[None]
        stack = np.concatenate([maps.diffuse, maps.specular, squared, maps.slopes, none])
        return np.ascontiguousarray(stack.reshape(len(stack), -1).T)

    @cached_property
    def _pyramid(self) -> tuple[Array, Array, Array]:
        """Rows of all levels, where each level starts, and (2, levels) widths and heights."""
        import cv2

        width, height = self.texture.size
        rows = self._rows
        level = rows.reshape(height, width, -1)
        square = (level[..., -3:-1] ** 2).sum(axis=-1)
        levels, sizes = [rows], [(width, height)]
        while max(width, height) > 1:
            width, height = max(1, width // 2), max(1, height // 2)
            level = np.dstack(
                [
                    cv2.resize(level[..., c], (width, height), interpolation=cv2.INTER_AREA)
                    for c in range(level.shape[2])
                ]
            ).reshape(height, width, -1)
            square = cv2.resize(square, (width, height), interpolation=cv2.INTER_AREA)
            square = square.reshape(height, width)
            mean = level[..., -3] ** 2 + level[..., -2] ** 2
            level[..., -1] = np.maximum(square - mean, 0.0)
            levels.append(level.reshape(width * height, -1))
            sizes.append((width, height))
        starts = np.cumsum([0, *(len(one) for one in levels[:-1])])
        return np.concatenate(levels), starts, np.array(sizes, dtype=np.int64).T

    def _trilinear(self, column: Array, row: Array, wide: Array) -> Array:
        """Values averaged over `wide` texels."""
        rows, starts, (widths, heights) = self._pyramid
        depth = np.clip(np.log2(np.maximum(wide, np.float32(1.0))), 0.0, len(starts) - 1.0)
        low = np.minimum(depth.astype(np.int64), max(len(starts) - 2, 0))
        share = (depth - low).astype(np.float32)
        total: Array | None = None
        for level, part in ((low, 1.0 - share), (np.minimum(low + 1, len(starts) - 1), share)):
            width, height = widths[level], heights[level]
            x = (column + 0.5) * (width / self.texture.size[0]) - 0.5
            y = (row + 0.5) * (height / self.texture.size[1]) - 0.5
            values = _gather(rows, starts[level], width, height, x, y) * part
            total = values if total is None else total + values
        assert total is not None
        return total


def bilinear(rows: Array, size: tuple[int, int], column: Array, row: Array) -> Array:
    """(C, ...) bilinear values of a repeating texture at columns and rows in texels.

    Args:
        rows: (H W, C) texels.
        size: (width, height).
        column, row: of one shape; texel centres are whole numbers.
    """
    return _gather(rows, 0, size[0], size[1], column, row)


def _gather(
    rows: Array,
    start: Array | int,
    width: Array | int,
    height: Array | int,
    column: Array,
    row: Array,
) -> Array:
    """Bilinear values of textures of `width` x `height` texels, stored from `start` on."""
    left, above = np.floor(column), np.floor(row)
    fx = (column - left).astype(np.float32)[..., None]
    fy = (row - above).astype(np.float32)[..., None]
    x0 = np.mod(left.astype(np.int64), width)
    y0 = np.mod(above.astype(np.int64), height)
    x1 = np.where(x0 + 1 == width, 0, x0 + 1)
    y1 = start + np.where(y0 + 1 == height, 0, y0 + 1) * width
    y0 = start + y0 * width
    upper = rows[y0 + x0] * (1.0 - fx) + rows[y0 + x1] * fx
    lower = rows[y1 + x0] * (1.0 - fx) + rows[y1 + x1] * fx
    return np.ascontiguousarray(np.moveaxis(upper * (1.0 - fy) + lower * fy, -1, 0))
