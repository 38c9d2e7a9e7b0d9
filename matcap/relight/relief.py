"""The height field that displaces a surface."""

from __future__ import annotations

from ctypes import byref, c_int64
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from matcap.relight.horizons import Horizons
from matcap.relight.loops.library import HeldArrays, Pointer, address, loops
from matcap.relight.loops.structures import CField
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array

# How far above the surface a ray must start, as a share of the relief, against rounding.
_LIFT = 2e-6


@dataclass(frozen=True)
class Relief:
    """The bilinear surface of a texture's height, as laid on a surface.

    Attributes:
        texture: the material.
        repeat: how many times smaller it lies there; its height shrinks likewise.
        displacement: factor on its height.
        endless: it repeats; else it goes on beyond its border as it is there, for what lies at
            the opposite border would be a cliff.
    """

    texture: Texture
    repeat: float
    displacement: float
    endless: bool = True

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
        width, height = self.texture.size
        lift = _LIFT * (self.high - self.low)
        place = self.heights.ctypes.data
        ends = int(not self.endless)
        return CField(place, width, height, ends, lift, self.high, self.low, self.texel_size)

    def at(self, u: Array, v: Array) -> Array:
        """Heights at places (u, v) in plane units, float32."""
        kept, shape = HeldArrays(), np.broadcast_shapes(u.shape, v.shape)
        places = (np.broadcast_to(one, shape) for one in self.texels(u, v))
        found = np.empty(shape, dtype=np.float32)
        loops().matcap_relight_heights(
            byref(self.field), c_int64(found.size),
            *(Pointer(kept.of(one, np.float64)) for one in places), address(found),
        )  # fmt: skip
        return found

    @property
    def around(self) -> Literal["wrap", "edge"]:
        """What np.pad puts around its texels."""
        return "wrap" if self.endless else "edge"

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
