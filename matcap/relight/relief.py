"""The height field that displaces a surface: bilinear between texel centres."""

from __future__ import annotations

import math
from ctypes import byref, c_int64
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from matcap.relight.loops.library import KeptArrays, Pointer, address, loops
from matcap.relight.loops.structures import CField
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array

# Offset of shadow rays above the surface, over the relief's height range, against rounding.
_LIFT = 2e-6
# clear_tangents bounds occluders by slope within _NEAR texels, by height in rings up to these.
_NEAR, _RINGS = 2, (5, 10, 20, 40)
_ROUNDING = 1.0 + 1e-5


@dataclass(frozen=True)
class Relief:
    """A texture's height, scaled to the surface it lies on."""

    texture: Texture
    """Maps of the material."""
    repeat: float
    """Factor by which the material is shrunk on the surface, heights included."""
    displacement: float
    """Factor on the heights."""
    endless: bool = True
    """Whether it repeats; else border heights are extended outwards, as opposite borders differ."""

    @cached_property
    def heights(self) -> Array:
        """(H W,) heights of the texels, scaled, in plane units."""
        factor = np.float32(self.displacement / self.repeat)
        return np.ascontiguousarray(self.texture.height[0] * factor).ravel()

    @cached_property
    def grid(self) -> Array:
        """(H, W) heights of the texels, scaled, in texels."""
        width, height = self.texture.size
        return self.heights.reshape(height, width) / np.float32(self.texel_size)

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
        """A texel's side on the surface, in plane units."""
        return self.texture.texel_size / self.repeat

    def texels(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Columns and rows of places in plane units; texel centres are whole numbers."""
        width, height = self.texture.size
        return u / self.texel_size + (width - 1) / 2.0, (height - 1) / 2.0 - v / self.texel_size

    @cached_property
    def field(self) -> CField:
        """The C structure of the loops; valid while this object lives."""
        width, height = self.texture.size
        lift, ends = _LIFT * (self.high - self.low), int(not self.endless)
        return CField(
            self.heights.ctypes.data, width, height, ends, lift, self.high, self.low,
            self.texel_size,
        )  # fmt: skip

    @cached_property
    def bounded_field(self) -> CField:
        """`field` with clear_tangents: loops that cast many rays from a place skip clear ones."""
        c_field = CField.from_buffer_copy(self.field)
        c_field.clear = self.clear_tangents.ctypes.data
        return c_field

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
        """Mode of np.pad that continues the heights beyond their border."""
        return "wrap" if self.endless else "edge"

    @cached_property
    def clear_tangents(self) -> Array:
        """(H W,) tangent of elevation above which no ray meets the surface, an upper bound.

        Valid for rays that start on the surface within half a texel of the texel's centre. Within
        _NEAR texels the bound is the steepest slope; in each ring beyond, the highest texel's
        height over the ring's inner radius.
        """
        wide = np.pad(self.grid, 1, mode=self.around)
        across, down = np.abs(np.diff(wide, axis=1)), np.abs(np.diff(wide, axis=0))
        # Steepest slope of each cell of four texels, then of the four cells around a texel.
        cells = np.hypot(np.maximum(across[:-1], across[1:]), np.maximum(down[:, :-1], down[:, 1:]))
        steep = np.maximum(cells[:-1], cells[1:])
        steep = np.maximum(steep[:, :-1], steep[:, 1:])
        lowest = self.grid - steep * np.float32(math.sqrt(0.5))
        upper = _highest(steep, _NEAR, self.around)
        nearest = float(_NEAR)
        for reach in _RINGS:
            peaks = _highest(self.grid, reach, self.around)
            upper = np.maximum(upper, (peaks - lowest) / nearest)
            nearest = reach - 0.5
        highest = np.float32(self.high / self.texel_size)
        upper = np.maximum(upper, (highest - lowest) / nearest) * np.float32(_ROUNDING)
        return np.ascontiguousarray(upper, dtype=np.float32).ravel()

    def peaks(self, reach: int) -> Array:
        """(H W,) maximum of the heights over a square of 2 reach + 1 texels."""
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
    """Maximum filter over a square of 2 reach + 1 texels (separable)."""
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
