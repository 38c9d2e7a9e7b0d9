"""Reading a texture between its texels; it repeats endlessly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from matcap.relight.lobes import alpha_of
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array, Vec

# Places this close to texel centres, in texels, are texel centres.
_ALIGNED = 1e-3


@dataclass(frozen=True)
class Sample:
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

    def read(self, place: tuple[Array, Array]) -> Sample:
        """The material at places (u, v) in plane units."""
        column, row = self.texels(place)
        aligned = self._aligned(column, row)
        if aligned is not None:
            return aligned
        column, row = np.broadcast_arrays(column, row)
        return self._bilinear(column, row)

    def _aligned(self, column: Array, row: Array) -> Sample | None:
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
        return Sample(
            tuple(maps.diffuse[cut]),
            tuple(maps.specular[cut]),
            self._alpha[cut[1:]],
            tuple(maps.normal[cut]),
        )

    def _bilinear(self, column: Array, row: Array) -> Sample:
        values = bilinear(self._rows, self.texture.size, column, row)
        split = 3 + len(self.texture.specular)
        x, y = values[split + 1], values[split + 2]
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        return Sample(tuple(values[:3]), tuple(values[3:split]), values[split], (-x * z, -y * z, z))

    @cached_property
    def _alpha(self) -> NDArray[np.float32]:
        alpha: NDArray[np.float32] = alpha_of(self.texture.roughness[0])
        return alpha

    @cached_property
    def _rows(self) -> NDArray[np.float32]:
        """(H W, C) diffuse, specular, alpha and slopes of each texel side by side."""
        maps = self.texture
        stack = np.concatenate([maps.diffuse, maps.specular, self._alpha[None], maps.slopes])
        return np.ascontiguousarray(stack.reshape(len(stack), -1).T)


def bilinear(
    rows: NDArray[np.float32], size: tuple[int, int], column: Array, row: Array
) -> NDArray[np.float32]:
    """(C, ...) bilinear values of a repeating texture at columns and rows in texels.

    Args:
        rows: (H W, C) texels.
        size: (width, height).
        column, row: of one shape; texel centres are whole numbers.
    """
    width, height = size
    left, above = np.floor(column), np.floor(row)
    fx = (column - left).astype(np.float32)[..., None]
    fy = (row - above).astype(np.float32)[..., None]
    x0 = np.mod(left.astype(np.int64), width)
    y0 = np.mod(above.astype(np.int64), height) * width
    x1 = np.where(x0 + 1 == width, 0, x0 + 1)
    y1 = np.where(y0 + width == width * height, 0, y0 + width)
    upper = rows[y0 + x0] * (1.0 - fx) + rows[y0 + x1] * fx
    lower = rows[y1 + x0] * (1.0 - fx) + rows[y1 + x1] * fx
    return np.ascontiguousarray(np.moveaxis(upper * (1.0 - fy) + lower * fy, -1, 0))
