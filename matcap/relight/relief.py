"""The height field that displaces a surface, as fast to read as it can be."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcap.relight.texture import Texture
from matcap.relight.vectors import Array

# Distances in texels between which the highest texel is looked up.
_RINGS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 128)
# Up to here slopes are looked up, too; further out the highest texel says more.
_SLOPING = 8


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
        # Remainders of floats: a few times as fast as of whole numbers, and exact all the same.
        left -= width * np.floor(left / width)
        above -= height * np.floor(above / height)
        here = (above * (width + 1.0) + left).astype(np.intp)
        z, below = self._bordered, here + (width + 1)
        z00, z10 = np.take(z, here), np.take(z, below)
        upper = z00 + fx * (np.take(z, here + 1) - z00)
        lower = z10 + fx * (np.take(z, below + 1) - z10)
        heights: Array = upper + fy * (lower - upper)
        return heights

    @cached_property
    def _bordered(self) -> Array:
        """The heights, row by row, with the first column and row again after the last."""
        width, height = self.texture.size
        field = self.heights.reshape(height, width)
        return np.ascontiguousarray(np.pad(field, ((0, 1), (0, 1)), mode="wrap")).ravel()

    def peaks(self, reach: int) -> Array:
        """(H W,) the highest texel within so many texels of each, along either axis."""
        if reach not in self._peaks:
            width, height = self.texture.size
            self._peaks[reach] = _highest(self.heights.reshape(height, width), reach).ravel()
        return self._peaks[reach]

    def steepest(self, reach: int) -> Array:
        """(H W,) the steepest slope of the surface within so many texels of each."""
        if reach not in self._steepest:
            self._steepest[reach] = _highest(self._slopes, reach).ravel()
        return self._steepest[reach]

    @cached_property
    def _steepest(self) -> dict[int, Array]:
        return {}

    @cached_property
    def _slopes(self) -> Array:
        """(H, W) slope of the surface around each texel."""
        width, height = self.texture.size
        field = self.heights.reshape(height, width)
        # Inside a cell a bilinear surface is nowhere steeper than along its sides.
        across = np.abs(np.roll(field, -1, axis=1) - field)
        down = np.abs(np.roll(field, -1, axis=0) - field)
        across = np.maximum(across, np.roll(across, -1, axis=0))
        down = np.maximum(down, np.roll(down, -1, axis=1))
        slope: Array = np.hypot(across, down) * np.float32(1.0 / self.texel_size)
        return slope

    def shelter(self, u: Array, v: Array, height: Array) -> Array:
        """The tangent of the highest elevation at which anything can hide a light; a bound.

        Args:
            u, v: places in plane units, of one shape.
            height: the surface there.
        """
        texel = self.nearest(u, v)
        # What rises, rises with the surface, and no higher than to the highest texel.
        # Two texels more: a place is up to half a one from the nearest, a cell reaches a whole.
        tangent = np.take(self.steepest(_RINGS[0] + 2), texel)
        rise = self.high - self.low
        for near, far in zip(_RINGS, _RINGS[1:], strict=False):
            distance = near * self.texel_size
            if rise <= float(tangent.min()) * distance:
                return tangent
            over = np.take(self.peaks(far + 2), texel) - height
            over *= np.float32(1.0 / distance)
            if far <= _SLOPING:
                np.minimum(over, np.take(self.steepest(far + 2), texel), out=over)
            np.maximum(tangent, over, out=tangent)
        rest = (self.high - height) * np.float32(1.0 / (_RINGS[-1] * self.texel_size))
        return np.maximum(tangent, rest)

    @cached_property
    def _peaks(self) -> dict[int, Array]:
        return {}

    def nearest(self, u: Array, v: Array) -> Array:
        """Indices of the texels nearest to places."""
        width, height = self.texture.size
        column, row = (np.rint(c) for c in self.texels(u, v))
        column -= width * np.floor(column / width)
        row -= height * np.floor(row / height)
        index: Array = (row * width + column).astype(np.intp)
        return index


def _highest(field: Array, reach: int) -> Array:
    """The largest value within so many texels along either axis, of a field that repeats."""
    import cv2

    for axis, size in enumerate(field.shape):
        if 2 * reach + 1 >= size:
            field = np.broadcast_to(field.max(axis=axis, keepdims=True), field.shape)
            continue
        around, kernel, cut = [(0, 0), (0, 0)], [1, 1], [slice(None), slice(None)]
        around[axis], kernel[axis], cut[axis] = (reach,) * 2, 2 * reach + 1, slice(reach, -reach)
        wide = np.pad(field, around, mode="wrap")
        field = np.asarray(cv2.dilate(wide, np.ones(kernel, np.uint8)))[tuple(cut)]
    return np.ascontiguousarray(field)
