"""Maps as the renderer reads them, and lookups: bilinear, or in a mip pyramid [olano2010]."""

from __future__ import annotations

from ctypes import byref, c_int64
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from matcap.brdf.edited import check_heights
from matcap.relight.camera import Array, Vec, unit3
from matcap.relight.loops.library import (
    DIFFUSE,
    SPECULAR,
    CLamp,
    CPixels,
    CTexels,
    KeptArrays,
    Pointer,
    address,
    loops,
)
from matcap.relight.scene import DirectionalLight

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet


# Maps of a material as the renderer reads them: channels first, float32, normals as slopes.

MIN_ROUGHNESS = 1e-3  # as matcap.brdf


def alpha_of(roughness: Array) -> Array:
    """GGX alpha of perceptual roughness: its square, at least 1e-6."""
    return np.square(np.maximum(roughness, roughness.dtype.type(MIN_ROUGHNESS)))


@dataclass(frozen=True)
class Extremes:
    """Extremes of a texture, over all its texels."""

    diffuse: float
    """Largest albedo of any channel."""
    specular: float
    """Largest F0 of any channel."""
    roughness: tuple[float, float]
    """(smallest, largest) roughness."""
    slope: float
    """Largest |slope| of the shading normals."""
    relief_slope: float
    """Largest |slope| of the bilinear surface through the heights, across repetitions, too."""
    relief: float
    """Highest minus lowest height, in plane units."""


@dataclass(frozen=True)
class Texture:
    """A rectangle of material; row 0 is the top, y points up."""

    diffuse: Array
    """(3, H, W) albedo."""
    specular: Array
    """(1, H, W) F0, or (3, H, W) where it is coloured."""
    roughness: Array
    """(1, H, W) perceptual roughness, sqrt of GGX alpha."""
    height: Array
    """(1, H, W) in plane units."""
    slopes: Array
    """(2, H, W) dh/dx and dh/dy of the shading normal (-dh/dx, -dh/dy, 1)."""
    texel_size: float
    """Side of a texel, plane units."""
    periodic: bool = True
    """Whether the maps tile seamlessly."""

    @staticmethod
    def from_maps(maps: MapSet) -> Texture:
        """The texture of a map set.

        Raises:
            ValueError: the maps have batch dimensions.
            MatcapError: heights that single precision cannot hold (check_heights).
        """
        if maps.height.ndim != 3:
            raise ValueError("maps with batch dimensions cannot be rendered: pass one map set")
        normal = maps.normal
        slopes = -normal[:2] / normal[2:]
        tensors = (maps.diffuse, maps.specular, maps.roughness, maps.height, slopes)
        a, b, c, d, e = (one.detach().cpu().float().contiguous().numpy() for one in tensors)
        check_heights(d, "the material")
        return Texture(a, b, c, d, e, maps.texel_size, maps.periodic)

    @staticmethod
    def from_stacked(stacked: Array, texel_size: float) -> Texture:
        """The texture of a rectangle of a field, without torch; the same bits as from_maps.

        Args:
            stacked: (6 or 8, H, W) float32 diffuse, F0, roughness and height; it does not repeat.
        """
        height = stacked[-1:]
        steep_x, steep_y = (_differences(height, axis) / np.float32(texel_size) for axis in (2, 1))
        z = 1.0 / np.sqrt(1.0 + steep_x * steep_x + steep_y * steep_y)
        # By way of the unit normal, as from_maps; rows run downwards, y runs upwards.
        slopes = np.concatenate([steep_x * z / z, -steep_y * z / z])
        diffuse, specular, roughness = np.split(stacked[:-1], [3, len(stacked) - 2])
        return Texture(diffuse, specular, roughness, height, slopes, texel_size, periodic=False)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in texels."""
        return self.height.shape[2], self.height.shape[1]

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) in plane units."""
        return self.size[0] * self.texel_size, self.size[1] * self.texel_size

    @cached_property
    def normal(self) -> Array:
        """(3, H, W) unit shading normals."""
        x, y = self.slopes
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        return np.stack([-x * z, -y * z, z])

    @cached_property
    def brightest(self) -> tuple[float, float, float]:
        """Largest albedo of each channel."""
        red, green, blue = (float(channel.max()) for channel in self.diffuse)
        return red, green, blue

    @cached_property
    def extremes(self) -> Extremes:
        """Largest and smallest values of the maps and slopes over all texels, for bounds."""
        height = self.height[0]
        # A bilinear cell's derivatives are between those along its sides.
        across = np.abs(np.roll(height, -1, axis=1) - height)
        down = np.abs(np.roll(height, -1, axis=0) - height)
        across = np.maximum(across, np.roll(across, -1, axis=0))
        down = np.maximum(down, np.roll(down, -1, axis=1))
        steepest = float((across * across + down * down).max()) ** 0.5 / self.texel_size
        x, y = self.slopes
        return Extremes(
            float(self.diffuse.max()),
            float(self.specular.max()),
            (float(self.roughness.min()), float(self.roughness.max())),
            float((x * x + y * y).max()) ** 0.5,
            steepest,
            float(height.max() - height.min()),
        )


def _differences(field: Array, axis: int) -> Array:
    """Differences per texel along an axis: central inside, one-sided at both ends."""
    along = np.moveaxis(field, axis, 0)
    if len(along) == 1:
        return np.zeros_like(field)
    inner = (along[2:] - along[:-2]) / np.float32(2.0)
    ends = along[1:2] - along[:1], along[-1:] - along[-2:-1]
    return np.moveaxis(np.concatenate([ends[0], inner, ends[1]]), 0, axis)


# Texture lookups: bilinear, or trilinear in a mip pyramid with slope variance [olano2010].

# Distance from texel centres, in texels, within which lookups return the texels themselves.
_ALIGNED = 1e-3


@dataclass(frozen=True)
class SurfaceSample:
    """The material at a block of pixels, arrays of one shape."""

    diffuse: tuple[Array, ...]
    """Albedo, one array a colour channel."""
    specular: tuple[Array, ...]
    """F0, one array or one a colour channel."""
    alpha: Array
    """GGX alpha, with the variance of unresolved slopes where lookups are filtered."""
    normal: Vec
    """Unit shading normal in the material's frame."""


@dataclass(frozen=True)
class Sampler:
    """A texture on a surface, its middle at (0, 0)."""

    texture: Texture
    """Maps of the material."""
    repeat: float
    """Factor by which the material is shrunk on the surface."""
    endless: bool = True
    """Whether it repeats; else lookups are clamped to its border."""

    def texels(self, place: tuple[Array, Array]) -> tuple[Array, Array]:
        """Columns and rows of places in plane units; texel centres are whole numbers."""
        width, height = self.texture.size
        step = self.repeat / self.texture.texel_size
        column = place[0] * step + (width - 1) / 2.0
        row = (height - 1) / 2.0 - place[1] * step
        if self.endless:
            return column, row
        return np.clip(column, 0.0, width - 1.0), np.clip(row, 0.0, height - 1.0)

    def covered(self, footprint: Array) -> Array:
        """Sides of pixels' footprints, converted from plane units to texels."""
        return footprint * np.float32(self.repeat / self.texture.texel_size)

    def read(self, place: tuple[Array, Array], footprint: Array | None = None) -> SurfaceSample:
        """Look up the material.

        Args:
            place: (u, v) on the surface, in plane units.
            footprint: side of each pixel's footprint in plane units, for a trilinear lookup; None
                is bilinear in the finest level.
        """
        column, row = self.texels(place)
        if footprint is None:
            aligned = self._aligned(column, row)
            if aligned is not None:
                return aligned
            return self._unpacked(between(self._rows, self.texture.size, column, row))
        wide = self.covered(footprint)
        return self._unpacked(read(self._pyramid, column, row, wide))

    def _aligned(self, column: Array, row: Array) -> SurfaceSample | None:
        """Texels themselves, where places are a grid of adjacent texel centres; else None."""
        if column.ndim != 2 or column.shape[0] != 1 or row.shape[1] != 1:
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
        return alpha_of(self.texture.roughness[0])

    @property
    def _planes(self) -> list[Array]:
        """(H, W) arrays: diffuse, specular, alpha^2, slopes x and y, slope variance (0)."""
        maps, squared = self.texture, np.square(self._alpha)
        return [*maps.diffuse, *maps.specular, squared, *maps.slopes, np.zeros_like(squared)]

    @cached_property
    def _rows(self) -> Array:
        """(H W, C) texels, of `_planes`."""
        planes = self._planes
        return np.stack(planes, axis=-1).reshape(-1, len(planes))

    @cached_property
    def _pyramid(self) -> CTexels:
        """All levels as a C structure.

        Means, and as slope variance mean(s^2) - mean(s)^2, summed over x and y.
        """
        import cv2

        planes, sizes = self._planes, [self.texture.size]
        while max(sizes[-1]) > 1:
            sizes.append((max(1, sizes[-1][0] // 2), max(1, sizes[-1][1] // 2)))
        rows = np.empty((sum(w * h for w, h in sizes), len(planes)), dtype=np.float32)
        square, start = planes[-3] ** 2 + planes[-2] ** 2, 0
        for width, height in sizes:
            if start:
                *planes, square = (
                    np.asarray(cv2.resize(one, (width, height), interpolation=cv2.INTER_AREA))
                    for one in (*planes, square)
                )
                planes[-1] = np.maximum(square - (planes[-3] ** 2 + planes[-2] ** 2), 0.0)
            level = rows[start : start + width * height].reshape(height, width, -1)
            np.stack([one.reshape(height, width) for one in planes], axis=-1, out=level)
            start += width * height
        return _texels(rows, sizes)


def between(rows: Array, size: tuple[int, int], column: Array, row: Array) -> Array:
    """(C, ...) bilinear lookups in a repeating texture.

    Args:
        rows: (H W, C) texels, C at most 16.
        size: (width, height) in texels.
        column, row: places in texels; texel centres are whole numbers.
    """
    return read(_texels(rows, [size]), column, row, None)


def read(texels: CTexels, column: Array, row: Array, wide: Array | None) -> Array:
    """(C, ...) trilinear lookups in a repeating texture.

    Args:
        texels: mip pyramid, as a C structure.
        column, row: places in texels of the finest level; texel centres are whole numbers.
        wide: side of the footprint in texels; None is bilinear in the finest level.
    """
    shape = np.broadcast_shapes(column.shape, row.shape)
    here = KeptArrays()
    places = [Pointer(here.of(np.broadcast_to(c, shape), np.float64)) for c in (column, row)]
    width = None if wide is None else here.of(np.broadcast_to(wide, shape))
    looked_up = np.empty((texels.channels, *shape), dtype=np.float32)
    loops().matcap_relight_read(
        byref(texels), c_int64(looked_up[0].size), *places, Pointer(width), address(looked_up)
    )
    return looked_up


def _texels(rows: Array, sizes: list[tuple[int, int]]) -> CTexels:
    kept = KeptArrays()
    starts = np.cumsum([0, *(width * height for width, height in sizes[:-1])])
    widths, heights = np.array(sizes).T
    texels = CTexels(
        kept.of(rows), kept.of(starts, np.int64), kept.of(widths, np.int32),
        kept.of(heights, np.int32), rows.shape[1], len(sizes),
    )  # fmt: skip
    return kept.kept_by(texels)


# Radiance of texels, seen from straight above without perspective, under one distant light.
#
# The renderer's loop of direct light (loops/lights.c) on maps as they are: one pixel a texel,
# without camera, plan and effects. For previews, where planning would take longer than rendering.


def light_texels(
    diffuse: Array, specular: Array, roughness: Array, normal: Array, light: DirectionalLight
) -> Array:
    """(3, H, W) radiance of maps, all float32 and channels first.

    Args:
        diffuse: (3, H, W) albedo.
        specular: (1 or 3, H, W) F0.
        roughness: (1, H, W) perceptual roughness.
        normal: (3, H, W) unit normals, y up.
    """
    kept, total = KeptArrays(), np.zeros(diffuse.shape, dtype=np.float32)
    flat, upright = np.zeros_like(roughness[0]), np.ones_like(roughness[0])
    straight = (kept.of(flat), kept.of(flat), kept.of(upright))
    pixels = CPixels(
        count=flat.size,
        point=straight,
        view=straight,
        normal=tuple(kept.of(axis) for axis in normal),
        n_dot_v=kept.of(np.maximum(normal[2], np.float32(0.0))),
        alpha=kept.of(alpha_of(roughness)),
        diffuse=tuple(kept.of(channel) for channel in diffuse),
        specular=tuple(kept.of(channel) for channel in np.broadcast_to(specular, diffuse.shape)),
        total=tuple(channel.ctypes.data for channel in total),
    )
    lamp = CLamp(
        place=tuple(unit3(light.direction)),
        colour=light.irradiance,
        far=1,
        power=1.0,
        parts=DIFFUSE + SPECULAR,
    )
    loops().matcap_relight_lamp(byref(pixels), byref(lamp), None)
    return total
