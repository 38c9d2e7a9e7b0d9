"""The height field that displaces a surface, as fast to read as it can be."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcap.relight.texture import Texture
from matcap.relight.vectors import Array


@dataclass(frozen=True)
class Relief:
    """The bilinear surface of a texture's height, repeated endlessly, as laid on a surface.

    Attributes:
        texture: the material.
        repeat: how many times smaller it lies there; its height shrinks likewise.
        displacement: factor on its height.
    """

    texture: Texture
    repeat: float
    displacement: float

    @cached_property
    def heights(self) -> Array:
        """(H W,) heights of the texels on the surface."""
        factor = np.float32(self.displacement / self.repeat)
        flat: Array = np.ascontiguousarray(self.texture.height[0] * factor).ravel()
        return flat

    @cached_property
    def low(self) -> float:
        """The lowest height."""
        return float(self.heights.min())

    @cached_property
    def high(self) -> float:
        """The highest height."""
        return float(self.heights.max())

    @property
    def texel_size(self) -> float:
        """A texel's side on the surface."""
        return self.texture.texel_size / self.repeat

    def texels(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Columns and rows, in texels, of places; texel centres are whole numbers."""
        width, height = self.texture.size
        return u / self.texel_size + (width - 1) / 2.0, (height - 1) / 2.0 - v / self.texel_size

    def at(self, u: Array, v: Array) -> Array:
        """Heights at places (u, v) in plane units, float32."""
        width, height = self.texture.size
        column, row = self.texels(u, v)
        left, above = np.floor(column), np.floor(row)
        fx, fy = (column - left).astype(np.float32), (row - above).astype(np.float32)
        x0 = np.mod(left.astype(np.int64), width)
        y0 = np.mod(above.astype(np.int64), height) * width
        x1 = np.where(x0 + 1 == width, 0, x0 + 1)
        y1 = np.where(y0 + width == width * height, 0, y0 + width)
        z = self.heights
        upper = z[y0 + x0] + fx * (z[y0 + x1] - z[y0 + x0])
        lower = z[y1 + x0] + fx * (z[y1 + x1] - z[y1 + x0])
        heights: Array = upper + fy * (lower - upper)
        return heights
