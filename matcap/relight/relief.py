"""The height field that displaces a surface."""

from __future__ import annotations

import math
from ctypes import byref, c_int64
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from matcap.relight.horizons import Horizons
from matcap.relight.loops.library import KeptArrays, Pointer, address, loops
from matcap.relight.loops.structures import CField
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array

# How far above the surface a ray must start, as a share of the relief, against rounding.
_LIFT = 2e-6
# Texels around one within which slopes bound what hides a ray; the outer rims of rings beyond.
_NEAR, _RINGS = 2, (5, 10, 20, 40)
_ROUNDING = 1.0 + 1e-5


@dataclass(frozen=True)
class Relief:
    """The bilinear surface of a texture's height, as laid on a surface."""

    texture: Texture
    """The material."""
    repeat: float
    """How many times smaller it lies there; its height shrinks likewise."""
    displacement: float
    """Factor on its height."""
    endless: bool = True
    """It repeats; else it goes on beyond its border as it is there, for what lies at the opposite
    border would be a cliff."""

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

    @cached_property
    def horizons(self) -> Horizons:
        """Of its texels, as far as they have been asked for; they are the same under any light."""
        return Horizons(self)

    @cached_property
    def field(self) -> CField:
        """As the loops know it; the heights live as long as this."""
        return self._field()

    @cached_property
    def swift(self) -> CField:
        """The same for loops that follow many rays from each place: none that are clear."""
        c_field = self._field()
        c_field.clear = self.clear.ctypes.data
        return c_field

    def _field(self) -> CField:
        width, height = self.texture.size
        lift, ends = _LIFT * (self.high - self.low), int(not self.endless)
        return CField(
            self.heights.ctypes.data, width, height, ends, lift, self.high, self.low,
            self.texel_size,
        )  # fmt: skip

    def at(self, u: Array, v: Array) -> Array:
        """Heights at places (u, v) in plane units, float32."""
        kept, shape = KeptArrays(), np.broadcast_shapes(u.shape, v.shape)
        places = (np.broadcast_to(one, shape) for one in self.texels(u, v))
        heights = np.empty(shape, dtype=np.float32)
        loops().matcap_relight_heights(
            byref(self.field), c_int64(heights.size),
            *(Pointer(kept.of(one, np.float64)) for one in places), address(heights),
        )  # fmt: skip
        return heights

    @property
    def around(self) -> Literal["wrap", "edge"]:
        """What np.pad puts around its texels."""
        return "wrap" if self.endless else "edge"

    @cached_property
    def clear(self) -> Array:
        """(H W,) tangents of elevation: no ray above them meets the surface.

        A texel's holds for rays that start on the surface within half a texel of it. Near by the
        surface rises no faster than it is steep; farther away, within each ring, it is no higher
        than the highest texel there and no nearer than the ring.
        """
        width, height = self.texture.size
        field = self.heights.reshape(height, width) / np.float32(self.texel_size)
        wide = np.pad(field, 1, mode=self.around)
        across, down = np.abs(np.diff(wide, axis=1)), np.abs(np.diff(wide, axis=0))
        # Of the cells between four texels, and then of the four cells around a texel.
        cells = np.hypot(np.maximum(across[:-1], across[1:]), np.maximum(down[:, :-1], down[:, 1:]))
        steep = np.maximum(cells[:-1], cells[1:])
        steep = np.maximum(steep[:, :-1], steep[:, 1:])
        lowest = field - steep * np.float32(math.sqrt(0.5))
        upper = _highest(steep, _NEAR, self.around)
        nearest = float(_NEAR)
        for reach in _RINGS:
            peaks = _highest(field, reach, self.around)
            upper = np.maximum(upper, (peaks - lowest) / nearest)
            nearest = reach - 0.5
        highest = np.float32(self.high / self.texel_size)
        upper = np.maximum(upper, (highest - lowest) / nearest) * np.float32(_ROUNDING)
        return np.ascontiguousarray(upper, dtype=np.float32).ravel()

    def peaks(self, reach: int) -> Array:
        """(H W,) the highest texel within so many texels of each, along either axis."""
        if reach not in self._peaks:
            width, height = self.texture.size
            self._peaks[reach] = _highest(
                self.heights.reshape(height, width), reach, self.around
            ).ravel()
        return self._peaks[reach]

    @cached_property
    def _peaks(self) -> dict[int, Array]:
        return {}


def _highest(field: Array, reach: int, mode: Literal["wrap", "edge"]) -> Array:
    """The largest value within so many texels along either axis."""
    import cv2

    for axis, size in enumerate(field.shape):
        if 2 * reach + 1 >= size:
            field = np.broadcast_to(field.max(axis=axis, keepdims=True), field.shape)
            continue
        around, kernel, cut = [(0, 0), (0, 0)], [1, 1], [slice(None), slice(None)]
        around[axis], kernel[axis], cut[axis] = (reach,) * 2, 2 * reach + 1, slice(reach, -reach)
        wide = np.pad(field, around, mode=mode)
        field = np.asarray(cv2.dilate(wide, np.ones(kernel, np.uint8)))[tuple(cut)]
    return np.ascontiguousarray(field)
