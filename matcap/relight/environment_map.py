"""Environment maps: read, radiance, irradiance, prefiltered by lobe width."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.names import note
from matcap.files.pixels import linear_colours, read_pixels
from matcap.files.settings import BRIGHTEST
from matcap.relight.camera import Array, Vec
from matcap.relight.loops.library import CEnvironment, KeptArrays
from matcap.relight.scene import EnvironmentLight

# Latitude-longitude EXR or Radiance HDR is read as linear Rec.709 radiance, converted from the
# primaries that the file states. Pixels outside of a data window are black. Code values (PNG,
# JPEG) are decoded, with a note.

_REMEDY = "give a latitude-longitude EXR or HDR picture"
_CUBE = "CubeFace Environment"
_SHAPE = 0.05  # largest relative deviation of the sides from 2 : 1
_DARK = 0.5  # largest sum of negative values over that of positive ones
_SMALLEST = 4  # pixels: smaller pictures may have any shape
_WIDEST = 2048  # wider maps are downsampled for use; a texel is then 0.18 degrees

EnvironmentPicture = NDArray[np.float32]


def read_picture(path: Path) -> EnvironmentPicture:
    """Read (H, W, 3) linear radiance: top row +y, middle column +z, right half towards -x.

    Raises:
        MatcapError: missing, unreadable, of another projection, not finite, mostly negative, or too
            bright.
    """
    where = str(path)
    if not path.is_file():
        raise MatcapError.at(where, "no such file", "check the path")
    pixels = read_pixels(path, outside=0.0)
    if pixels.surroundings == _CUBE:
        raise MatcapError.at(where, "is a cube map, of six faces", _REMEDY)
    picture, notes = linear_colours(pixels)
    for sentence in (*pixels.notes, *notes):
        note(f"{where}: {sentence}")
    if pixels.whole:
        note(f"{where}: code values, not light: decoded, and nothing is brighter than white (1.0)")
    if pixels.partial:
        note(f"{where}: the file holds a part of its picture (its data window); the rest is black")
    picture = _radiance(np.asarray(picture, np.float32), where)
    height, width = picture.shape[:2]
    if max(width, height) > _SMALLEST and abs(width / (2.0 * height) - 1.0) > _SHAPE:
        raise MatcapError.at(
            where,
            f"is {width} x {height} pixels, and such a picture is twice as wide as high",
            _REMEDY,
        )
    return picture


def narrowed(picture: EnvironmentPicture) -> EnvironmentPicture:
    """The picture, downsampled if it is wider than programs need."""
    height, width = picture.shape[:2]
    if width <= _WIDEST:
        return picture
    size = (_WIDEST, max(2, round(height * _WIDEST / width)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


def _radiance(picture: EnvironmentPicture, where: str) -> EnvironmentPicture:
    """Radiance clamped to 0, with a note; small negative values are rounding or out of gamut.

    Raises:
        MatcapError: values above BRIGHTEST, or negative ones that add up to half of the light.
    """
    if picture.max() > BRIGHTEST:
        raise MatcapError.at(
            where,
            f"has a value of {picture.max():.2g}, too bright for single precision",
            "clip its brightest pixels in a picture editor",
        )
    below = picture < 0.0
    if not below.any():
        return picture
    dark, light = (float(np.abs(picture[part]).sum(dtype=np.float64)) for part in (below, ~below))
    if dark > _DARK * light:
        raise MatcapError.at(where, "is mostly negative, which no radiance is", _REMEDY)
    pixels = int(below.any(axis=2).sum())
    note(f"{where}: {pixels} pixels are negative, down to {picture.min():.3g}, and set to 0")
    return np.maximum(picture, np.float32(0.0))


# Environment maps prefiltered by lobe width, in octahedral parametrisation [engelhardt2008].
#
# A mip pyramid; a lookup is bilinear within one level. Box filter and bilinear kernel together add
# 1/4 texel^2 of variance along each axis, which blunts smooth maxima. Each level is therefore
# sharpened by 3/2 - 1/8 (sum of four neighbours): lookups are then exact for radiance that is
# quadratic over a few texels, and small bright spots still count in full.

_FINEST, _COARSEST = 1024, 4
# Samples along a texel's side of the finest level.
_RAYS = 2


@dataclass(frozen=True)
class Octahedra:
    """All levels in one picture, each with a border of one texel that continues it."""

    atlas: Array
    """(h, w, 3) float32 radiance, levels from the finest at the top."""
    tops: Array
    """(levels,) first row of each level in the atlas."""
    sides: Array
    """(levels,) texels along a side of each level, border excluded."""

    def as_c(self) -> CEnvironment:
        """The levels as a C structure (loops/library.py)."""
        kept, width = KeptArrays(), self.atlas.shape[1]
        arrays = (kept.of(one) for one in (self.atlas, self.tops, self.sides))
        # Square root of the mean solid angle of a texel of the finest level, in radians.
        finest = math.sqrt(4.0 * math.pi) / float(self.sides[0])
        return kept.kept_by(CEnvironment(*arrays, width, len(self.sides), finest))


def unfolded(u: Array, v: Array) -> Vec:
    """Unit vectors of places (u, v) in [-1, 1]^2 on the octahedral map; z > 0 in its middle."""
    z = 1.0 - np.abs(u) - np.abs(v)
    fold = np.maximum(-z, 0.0)
    x, y = u - np.copysign(fold, u), v - np.copysign(fold, v)
    inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
    return x * inverse, y * inverse, z * inverse


def octahedra(radiance: Callable[[Vec], Array], rows: int) -> Octahedra:
    """Sample a radiance function into a pyramid of octahedral maps.

    Args:
        radiance: (3, ...) radiance along unit vectors.
        rows: of the latitude-longitude map behind it: the finest level is about as fine.
    """
    side = min(max(2 ** math.ceil(math.log2(1.13 * rows)), 2 * _COARSEST), _FINEST)
    level = np.zeros((side, side, 3), dtype=np.float32)
    for i in range(_RAYS):
        for j in range(_RAYS):
            at = [((np.arange(side) + (k + 0.5) / _RAYS) / side * 2.0 - 1.0) for k in (i, j)]
            u, v = np.meshgrid(at[1].astype(np.float32), at[0].astype(np.float32))
            level += np.moveaxis(radiance(unfolded(u, v)), 0, -1) / np.float32(_RAYS**2)
    levels = [_bordered(level)]
    while side > _COARSEST:
        side //= 2
        level = level.reshape(side, 2, side, 2, 3).mean(axis=(1, 3))
        levels.append(_bordered(level))
    sides = np.array([len(one) - 2 for one in levels], dtype=np.float32)
    tops = np.cumsum([0, *(len(one) for one in levels[:-1])]).astype(np.float32)
    atlas = np.zeros((sum(len(one) for one in levels), len(levels[0]), 3), dtype=np.float32)
    for top, one in zip(tops.astype(int), levels, strict=True):
        atlas[top : top + len(one), : len(one)] = one
    return Octahedra(atlas, tops, sides)


def _bordered(level: Array) -> Array:
    """A level, sharpened (1.5 minus an eighth of each neighbour), with its border."""
    around = _wrapped(level)
    near = around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:]
    return _wrapped(np.float32(1.5) * level - np.float32(0.125) * near)


def _wrapped(level: Array) -> Array:
    """Add a border of one texel: beyond an edge, the octahedron continues with it reversed."""
    wide = np.concatenate([level[::-1, :1], level, level[::-1, -1:]], axis=1)
    return np.concatenate([wide[:1, ::-1], wide, wide[-1:, ::-1]], axis=0)


# Environment maps: radiance along a direction, irradiance, vector irradiance.
#
# The map stays latitude-longitude, with a mip pyramid; a lookup turns its direction by the light's
# rotation.

# Columns of the latitude-longitude grid that integrals sum over; it has half as many rows.
_SUMMED = 256
# Side of the octahedral table of irradiance by normal.
_NORMALS = 64

# Bright texels are gathered into suns in cells of 180 / _PLACES = 5.6 degrees, _SUNS at most.
_PLACES, _SUNS = 32, 16
# Over the brightest texel: a map whose remainder is darker than this holds suns alone.
_BLACK = 1e-9


class Sun(NamedTuple):
    """A small bright spot of an environment, shaded as a directional light."""

    direction: tuple[float, float, float]
    """Unit vector of the scene."""
    irradiance: tuple[float, float, float]
    """Irradiance of a surface that faces it."""


@dataclass(frozen=True)
class Environment:
    """One environment light, prepared for shading."""

    levels: tuple[Array, ...]
    """Mip pyramid of radiance: (h, w, 3), each level half the size of the one before."""
    rotation: float
    """About +y, in radians, anticlockwise from above."""

    @cached_property
    def brightest(self) -> float:
        """Largest radiance of any channel."""
        return float(self.levels[0].max())

    @cached_property
    def mean(self) -> Array:
        """(3,) radiance averaged over all directions."""
        top = self.levels[0]
        if (top == top[0, 0]).all():
            return top[0, 0]  # exactly
        weights = np.sin((np.arange(len(top)) + 0.5) * math.pi / len(top))
        return (top.mean(axis=1) * weights[:, None]).sum(0) / weights.sum()

    @cached_property
    def varying(self) -> float:
        """Largest difference of a texel's radiance from the mean."""
        return float(np.abs(self.levels[0] - self.mean).max())

    @cached_property
    def _split(self) -> tuple[Environment, tuple[Sun, ...]]:
        """The map clamped to a limit, and what is above it, gathered in suns.

        The limit is four times the mean of the clamped map, or higher where more than _SUNS cells
        would be above it.
        """
        top = self.levels[0]
        height, width = top.shape[:2]
        rows = np.minimum(np.arange(height) * _PLACES // height, _PLACES - 1)
        columns = np.arange(width) * 2 * _PLACES // width
        cell = rows[:, None] * 2 * _PLACES + columns
        limit, raised = 4.0 * self.mean.max(), False
        while True:
            over = (top > limit).any(axis=2)
            if len(np.unique(cell[over])) <= _SUNS:
                # A sun may dominate the mean: iterate with the mean of the clamped map.
                lower = 4.0 * Environment((np.minimum(top, limit),), 0.0).mean.max()
                if raised or lower > limit / 100.0 or limit <= _BLACK * self.brightest:
                    break
                limit = lower
            else:
                # Too many bright cells, such as stars: raise the limit, for good.
                limit, raised = 1.5 * limit, True
        if not over.any():
            return self, ()
        without_suns = np.minimum(top, np.float32(limit))
        rows, columns = np.nonzero(over)
        towards = _directions(rows, columns, (height, width), self.rotation)
        power = (top - without_suns)[over] * _solid_angles(height, width)[rows][:, None]
        suns = []
        for one in np.unique(cell[over]):
            part = cell[over] == one
            middle = (towards[part] * power[part].sum(axis=1, keepdims=True)).sum(axis=0)
            x, y, z = (float(c) for c in middle / np.linalg.norm(middle))
            r, g, b = (float(c) for c in power[part].sum(axis=0))
            suns.append(Sun((x, y, z), (r, g, b)))
        return Environment(_pyramid(without_suns), self.rotation), tuple(suns)

    @property
    def without_suns(self) -> Environment:
        """The environment clamped to a few times its mean: without the light of `suns`."""
        return self._split[0]

    @property
    def suns(self) -> tuple[Sun, ...]:
        """Small bright spots that `without_suns` lacks; 16 at most."""
        return self._split[1]

    def above_plane(self) -> Environment:
        """The environment with all directions below z = 0 set to the mean of those above.

        A plane sees the upper half only. Its own radiance below would enter the mean, and then have
        to cancel in single precision.
        """
        top = self.levels[0]
        height, width = top.shape[:2]
        rows, columns = np.indices((height, width))
        z = _directions(rows, columns, (height, width), self.rotation)[..., 2]
        # Bilinear lookups above the plane also read the first texels below it: keep those.
        padded = np.pad((z > 0.0).astype(np.uint8), ((1, 1), (1, 1)), "wrap")
        near = cv2.dilate(padded, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
        if near.all() or (top == top[0, 0]).all():
            return self
        weights = np.sin((np.arange(height) + 0.5) * math.pi / height)[:, None] * (z > 0.0)
        seen = (top.astype(np.float64) * weights[..., None]).sum((0, 1)) / weights.sum()
        picture = np.where(near[..., None], top, seen.astype(np.float32))
        return Environment(_pyramid(picture), self.rotation)

    @cached_property
    def octahedra(self) -> Octahedra:
        """The same radiance in octahedral maps, prefiltered for lobes."""
        return octahedra(self.radiance, len(self.levels[0]))

    def radiance(self, direction: Vec, level: int = 0) -> Array:
        """(3, ...) radiance along unit vectors of the scene, bilinear within a level."""
        if self.varying == 0.0:
            shape = np.broadcast_shapes(*(c.shape for c in direction))
            return np.broadcast_to(
                self.levels[0][0, 0][(slice(None), *[None] * len(shape))], (3, *shape)
            )
        flat = self.levels[level].reshape(-1, 3)
        height, width = np.array(self.levels[level].shape[:2], dtype=np.int32)
        x, y, z = direction
        azimuth = np.arctan2(-x, z) + np.float32(math.remainder(self.rotation, 2.0 * math.pi))
        column = (azimuth * np.float32(0.5 / math.pi) + np.float32(0.5)) * width - np.float32(0.5)
        polar = np.arccos(np.clip(y, -1.0, 1.0))
        row = np.clip(polar * np.float32(1.0 / math.pi) * height - 0.5, 0.0, height - 1.0)
        left = np.floor(column)
        fx = (column - left).astype(np.float32)[..., None]
        x0 = left.astype(np.int32)
        x0 = x0 + width * ((x0 < 0).astype(np.int32) - (x0 >= width))
        x1 = np.where(x0 + 1 == width, 0, x0 + 1)
        y0 = np.minimum(row.astype(np.int32), height - 2)
        fy = (row - y0).astype(np.float32)[..., None]
        y0 = y0 * width
        y1 = y0 + width
        upper = flat[y0 + x0] * (1.0 - fx) + flat[y0 + x1] * fx
        lower = flat[y1 + x0] * (1.0 - fx) + flat[y1 + x1] * fx
        return np.moveaxis(upper * (1.0 - fy) + lower * fy, -1, 0)

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """(N, 3) unit vectors of the scene, and (N, 3) (radiance - mean) times solid angle.

        The quadrature of all integrals; the mean's part has a closed form.
        """
        width, height = _SUMMED, _SUMMED // 2
        rows, columns = np.indices((height, width)).reshape(2, -1)
        towards = _directions(rows, columns, (height, width), self.rotation)
        solid = _solid_angles(height, width)[rows]
        # A level no finer than the grid: every texel counts.
        level = max(0, math.ceil(math.log2(self.levels[0].shape[1] / width)))
        seen = self.radiance(tuple(towards.T), level)
        return towards.astype(np.float32), ((seen.T - self.mean) * solid[:, None]).astype(
            np.float32
        )

    def vector(self, *, above: bool) -> Array:
        """(3, 3) integral of (radiance - mean) times direction: rows are axes, columns colours.

        Over directions with z > 0 if `above`, else over all.
        """
        return self._vectors[0 if above else 1]

    @cached_property
    def _vectors(self) -> tuple[Array, Array]:
        towards, power = (one.astype(np.float64) for one in self.directions)
        up = towards[:, 2] > 0.0
        return towards[up].T @ power[up], towards.T @ power

    @cached_property
    def _above(self) -> Array:
        """(n, n, 3) irradiance of (radiance - mean) with z > 0, on normals with z > 0."""
        grid = np.linspace(-1.0, 1.0, _NORMALS)
        a, b = np.meshgrid(grid, grid)
        # Half an octahedron, turned by 45 degrees, fills the square.
        x, y = (a + b) / 2.0, (a - b) / 2.0
        return self._irradiance(x, y, 1.0 - np.abs(x) - np.abs(y), clip=True)

    @cached_property
    def _around(self) -> Array:
        """(n, n, 3) irradiance of (radiance - mean) on all normals, octahedral."""
        grid = np.linspace(-1.0, 1.0, _NORMALS)
        x, y = np.meshgrid(grid, grid)
        z = 1.0 - np.abs(x) - np.abs(y)
        fold = np.maximum(-z, 0.0)
        x, y = x - np.copysign(fold, x), y - np.copysign(fold, y)
        return self._irradiance(x, y, z, clip=False)

    def _irradiance(self, x: Array, y: Array, z: Array, *, clip: bool) -> Array:
        if self.varying == 0.0:
            return np.zeros((*x.shape, 3), dtype=np.float32)
        normal = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
        towards, power = self.directions
        if clip:
            power = np.where(towards[:, 2:] > 0.0, power, np.float32(0.0))
        total = np.zeros((len(normal), 3), dtype=np.float32)
        for start in range(0, len(normal), 256):
            part = slice(start, start + 256)
            cosines = normal[part] @ towards.T
            total[part] = np.maximum(cosines, 0.0, out=cosines) @ power
        return total.reshape(*x.shape, 3)

    def irradiance_above(self, normal: Vec) -> Array:
        """(3, ...) irradiance of directions with z > 0, on normals with z > 0."""
        x, y, z = normal
        norm = 1.0 / (np.abs(x) + np.abs(y) + z)
        x, y = x * norm, y * norm
        whole = (math.pi * self.mean).astype(np.float32).reshape(3, *[1] * normal[2].ndim)
        share = np.float32(0.5) * (1.0 + normal[2])
        return np.maximum(_table(self._above, x + y, x - y) + whole * share, np.float32(0.0))

    def irradiance(self, normal: Vec) -> Array:
        """(3, ...) irradiance of all directions, on any unit normals of the scene."""
        x, y, z = normal
        norm = 1.0 / (np.abs(x) + np.abs(y) + np.abs(z))
        x, y, z = x * norm, y * norm, z * norm
        below = z < 0.0
        u = np.where(below, np.copysign(1.0 - np.abs(y), x), x)
        v = np.where(below, np.copysign(1.0 - np.abs(x), y), y)
        whole = (math.pi * self.mean).astype(np.float32).reshape(3, *[1] * normal[2].ndim)
        return np.maximum(_table(self._around, u, v) + whole, np.float32(0.0))


def environment_of(light: EnvironmentLight) -> Environment:
    """Read and prepare the environment of a light.

    Raises:
        MatcapError: as read_picture.
    """
    if light.file is None:
        picture = np.asarray(light.radiance, dtype=np.float32)[None, None] * np.float32(light.scale)
        return Environment((np.broadcast_to(picture, (2, 4, 3)).copy(),), 0.0)
    picture = read_picture(light.file) * np.float32(light.scale)
    return Environment(_pyramid(picture), math.radians(light.rotation))


def _directions(rows: Array, columns: Array, size: tuple[int, int], rotation: float) -> Array:
    """(..., 3) unit vectors of the scene to centres of texels of a (height, width) map."""
    height, width = size
    azimuth = ((columns + 0.5) / width - 0.5) * 2.0 * math.pi - rotation
    polar = (rows + 0.5) * math.pi / height
    ring = np.sin(polar)
    return np.stack([-np.sin(azimuth) * ring, np.cos(polar), np.cos(azimuth) * ring], axis=-1)


def _solid_angles(height: int, width: int) -> Array:
    """(height,) solid angle of a texel of each row, in steradians."""
    edges = np.cos(np.arange(height + 1) * math.pi / height)
    return (edges[:-1] - edges[1:]) * 2.0 * math.pi / width


def _pyramid(picture: Array) -> tuple[Array, ...]:
    picture = narrowed(picture)
    if len(picture) < 2:
        picture = np.repeat(picture, 2, axis=0)
    levels = [picture]
    while min(levels[-1].shape[:2]) >= 8:
        height, width = levels[-1].shape[:2]
        half = cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, dtype=np.float32))
    return tuple(levels)


def _table(table: Array, u: Array, v: Array) -> Array:
    """(3, ...) bilinear values of a table at u (columns) and v (rows) in [-1, 1]."""
    last = _NORMALS - 1
    x = np.clip((u + 1.0) * np.float32(last / 2.0), 0.0, last)
    y = np.clip((v + 1.0) * np.float32(last / 2.0), 0.0, last)
    j = np.minimum(x.astype(np.int32), last - 1)
    i = np.minimum(y.astype(np.int32), last - 1)
    fx, fy = (x - j).astype(np.float32)[..., None], (y - i).astype(np.float32)[..., None]
    flat = table.reshape(-1, 3)
    at = i * _NORMALS + j
    upper = flat[at] * (1.0 - fx) + flat[at + 1] * fx
    at = at + _NORMALS
    lower = flat[at] * (1.0 - fx) + flat[at + 1] * fx
    return np.moveaxis(upper * (1.0 - fy) + lower * fy, -1, 0)
