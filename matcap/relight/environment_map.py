"""Environment map lookups: radiance along a direction, and irradiance.

A picture is kept as latitude by longitude, as it came, with a pyramid of averages for wide lobes.
Directions are turned by the light's rotation on the way in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from matcap.relight.environment_file import read_picture
from matcap.relight.octahedron import Octahedra, octahedra
from matcap.relight.scene import EnvironmentLight
from matcap.relight.vectors import Array, Vec

# Wider pictures are averaged down: a texel of 2048 is 0.18 degrees.
_WIDEST = 2048
# Directions that an irradiance is summed over, across.
_SUMMED = 256
# Normals that irradiance is tabulated for, along each axis of their octahedron.
_NORMALS = 64

# Suns are gathered in cells of 5.6 degrees, and there are no more than so many.
_PLACES, _SUNS = 32, 16
# Of the brightest texel: surroundings that are darker but for their suns are black.
_BLACK = 1e-9

SkyPicture = Array


class Sun(NamedTuple):
    """A small bright spot: direction in the scene, and irradiance on a surface facing it."""

    direction: tuple[float, float, float]
    irradiance: tuple[float, float, float]


@dataclass(frozen=True)
class Environment:
    """One environment light, ready to shade with."""

    levels: tuple[SkyPicture, ...]
    """(h, w, 3) radiance pictures, each half as large as the one before."""
    rotation: float
    """Radians."""

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
        mean: Array = (top.mean(axis=1) * weights[:, None]).sum(0) / weights.sum()
        return mean

    @cached_property
    def varying(self) -> float:
        """By how much the radiance differs from its mean, at most."""
        return float(np.abs(self.levels[0] - self.mean).max())

    @cached_property
    def _parted(self) -> tuple[Environment, tuple[Sun, ...]]:
        """What is left without suns, and these."""
        top = self.levels[0]
        height, width = top.shape[:2]
        rows = np.minimum(np.arange(height) * _PLACES // height, _PLACES - 1)
        columns = np.arange(width) * 2 * _PLACES // width
        cell = rows[:, None] * 2 * _PLACES + columns
        limit, raised = 4.0 * self.mean.max(), False
        while True:
            over = (top > limit).any(axis=2)
            if len(np.unique(cell[over])) <= _SUNS:
                # A sun may be so bright that it is the mean.
                lower = 4.0 * Environment((np.minimum(top, limit),), 0.0).mean.max()
                if raised or lower > limit / 100.0 or limit <= _BLACK * self.brightest:
                    break
                limit = lower
            else:
                # Too many for suns, whatever is lower: as of a sky full of stars.
                limit, raised = 1.5 * limit, True
        if not over.any():
            return self, ()
        calm = np.minimum(top, np.float32(limit))
        towards = self.texel_directions(*np.nonzero(over))
        edges = np.cos(np.arange(height + 1) * math.pi / height)
        solid = (edges[:-1] - edges[1:]) * 2.0 * math.pi / width
        power = (top - calm)[over] * solid[np.nonzero(over)[0]][:, None]
        suns = []
        for one in np.unique(cell[over]):
            part = cell[over] == one
            middle = (towards[part] * power[part].sum(axis=1, keepdims=True)).sum(axis=0)
            x, y, z = (float(c) for c in middle / np.linalg.norm(middle))
            r, g, b = (float(c) for c in power[part].sum(axis=0))
            suns.append(Sun((x, y, z), (r, g, b)))
        return Environment(_pyramid(calm), self.rotation), tuple(suns)

    @property
    def calm(self) -> Environment:
        """The surroundings without their suns: no texel brighter than a few times the mean."""
        return self._parted[0]

    @property
    def suns(self) -> tuple[Sun, ...]:
        """Small bright spots, 16 at most, that `calm` lacks."""
        return self._parted[1]

    def above_plane(self) -> Environment:
        """What a plane z = 0 can see of them; all below is as bright as that on average.

        What no sum needs must not cancel in it either.
        """
        import cv2

        top = self.levels[0]
        height, width = top.shape[:2]
        rows, columns = np.divmod(np.arange(height * width), width)
        z = self.texel_directions(rows, columns)[:, 2].reshape(height, width)
        # Texels are interpolated with their neighbours: those of seen ones stay.
        padded = np.pad((z > 0.0).astype(np.uint8), ((1, 1), (1, 1)), "wrap")
        near = cv2.dilate(padded, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
        if near.all() or (top == top[0, 0]).all():
            return self
        weights = np.sin((np.arange(height) + 0.5) * math.pi / height)[:, None] * (z > 0.0)
        seen = (top.astype(np.float64) * weights[..., None]).sum((0, 1)) / weights.sum()
        picture = np.where(near[..., None], top, seen.astype(np.float32))
        return Environment(_pyramid(picture), self.rotation)

    def texel_directions(self, rows: Array, columns: Array) -> Array:
        """(N, 3) directions of the scene of texels' centres."""
        height, width = self.levels[0].shape[:2]
        azimuth = ((columns + 0.5) / width - 0.5) * 2.0 * math.pi - self.rotation
        polar = (rows + 0.5) * math.pi / height
        ring = np.sin(polar)
        return np.stack([-np.sin(azimuth) * ring, np.cos(polar), np.cos(azimuth) * ring], axis=-1)

    @cached_property
    def octahedra(self) -> Octahedra:
        """The same, to be looked up quickly."""
        return octahedra(self.radiance, len(self.levels[0]))

    @cached_property
    def _texels(self) -> tuple[SkyPicture, Array, Array]:
        """All levels' texels (N, 3), where each level starts, and (2, levels) heights, widths."""
        flat = np.concatenate([level.reshape(-1, 3) for level in self.levels])
        sizes = np.array([level.shape[:2] for level in self.levels], dtype=np.int32).T
        starts = np.concatenate([[0], np.cumsum(sizes[0] * sizes[1])[:-1]]).astype(np.int32)
        return flat, starts, sizes

    def radiance(self, direction: Vec, level: Array | int = 0) -> Array:
        """(3, ...) radiance along unit directions of the scene, bilinear within a level."""
        if self.varying == 0.0:
            shape = np.broadcast_shapes(*(c.shape for c in direction))
            return np.broadcast_to(
                self.levels[0][0, 0][(slice(None), *[None] * len(shape))], (3, *shape)
            )
        flat, starts, (heights, widths) = self._texels
        height, width, start = heights[level], widths[level], starts[level]
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
        y0 = start + y0 * width
        y1 = y0 + width
        upper = flat[y0 + x0] * (1.0 - fx) + flat[y0 + x1] * fx
        lower = flat[y1 + x0] * (1.0 - fx) + flat[y1 + x1] * fx
        return np.moveaxis(upper * (1.0 - fy) + lower * fy, -1, 0)

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """(N, 3) directions of the scene, and (N, 3) what differs from the mean radiance there.

        Times solid angle, to sum over; the mean itself is added in closed form.
        """
        width, height = _SUMMED, _SUMMED // 2
        azimuth = ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * math.pi - self.rotation
        edges = np.cos(np.arange(height + 1) * math.pi / height)
        polar = (np.arange(height) + 0.5) * math.pi / height
        y, ring = np.cos(polar)[:, None], np.sin(polar)[:, None]
        towards = np.stack(
            np.broadcast_arrays(-np.sin(azimuth) * ring, y, np.cos(azimuth) * ring), axis=-1
        ).reshape(-1, 3)
        solid = np.repeat((edges[:-1] - edges[1:]) * 2.0 * math.pi / width, width)
        # A level no finer than the sum, so that no texel falls between its directions.
        level = max(0, math.ceil(math.log2(self.levels[0].shape[1] / width)))
        seen = self.radiance(tuple(towards.T), level)  # type: ignore[arg-type]
        return towards.astype(np.float32), ((seen.T - self.mean) * solid[:, None]).astype(
            np.float32
        )

    def vector(self, *, above: bool) -> Array:
        """(3, 3) sum of radiance times direction of what shines from above the plane, or of all.

        A row for each axis of the scene, a column for each colour.
        """
        return self._vectors[0 if above else 1]

    @cached_property
    def _vectors(self) -> tuple[Array, Array]:
        towards, power = (one.astype(np.float64) for one in self.directions)
        up = towards[:, 2] > 0.0
        return towards[up].T @ power[up], towards.T @ power

    @cached_property
    def _above(self) -> SkyPicture:
        """(n, n, 3) what differs from the mean's irradiance, upper half on upper normals."""
        grid = np.linspace(-1.0, 1.0, _NORMALS)
        a, b = np.meshgrid(grid, grid)
        # Half an octahedron, turned by 45 degrees to fill a square.
        x, y = (a + b) / 2.0, (a - b) / 2.0
        return self._irradiance(x, y, 1.0 - np.abs(x) - np.abs(y), clip=True)

    @cached_property
    def _around(self) -> SkyPicture:
        """(n, n, 3) what differs from the mean's irradiance, on all normals, octahedral."""
        grid = np.linspace(-1.0, 1.0, _NORMALS)
        x, y = np.meshgrid(grid, grid)
        z = 1.0 - np.abs(x) - np.abs(y)
        fold = np.maximum(-z, 0.0)
        x, y = x - np.copysign(fold, x), y - np.copysign(fold, y)
        return self._irradiance(x, y, z, clip=False)

    def _irradiance(self, x: Array, y: Array, z: Array, *, clip: bool) -> SkyPicture:
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
            total[part] = np.maximum(normal[part] @ towards.T, 0.0) @ power
        return total.reshape(*x.shape, 3)

    def irradiance_above(self, normal: Vec) -> Array:
        """(3, ...) irradiance on normals with z > 0 of what shines from above the plane."""
        x, y, z = normal
        norm = 1.0 / (np.abs(x) + np.abs(y) + z)
        x, y = x * norm, y * norm
        whole = (math.pi * self.mean).astype(np.float32).reshape(3, *[1] * normal[2].ndim)
        share = np.float32(0.5) * (1.0 + normal[2])
        return np.maximum(_table(self._above, x + y, x - y) + whole * share, np.float32(0.0))

    def irradiance(self, normal: Vec) -> Array:
        """(3, ...) irradiance on any normals of the scene."""
        x, y, z = normal
        norm = 1.0 / (np.abs(x) + np.abs(y) + np.abs(z))
        x, y, z = x * norm, y * norm, z * norm
        below = z < 0.0
        u = np.where(below, np.copysign(1.0 - np.abs(y), x), x)
        v = np.where(below, np.copysign(1.0 - np.abs(x), y), y)
        whole = (math.pi * self.mean).astype(np.float32).reshape(3, *[1] * normal[2].ndim)
        return np.maximum(_table(self._around, u, v) + whole, np.float32(0.0))


def environment_of(light: EnvironmentLight) -> Environment:
    """The environment of a light; reads its picture.

    Raises:
        MatcapError: the picture is missing, broken, or has values that are no radiance.
    """
    if light.file is None:
        picture = np.asarray(light.radiance, dtype=np.float32)[None, None] * np.float32(light.scale)
        return Environment((np.broadcast_to(picture, (2, 4, 3)).copy(),), 0.0)
    picture = read_picture(light.file) * np.float32(light.scale)
    return Environment(_pyramid(picture), math.radians(light.rotation))


def _pyramid(picture: SkyPicture) -> tuple[SkyPicture, ...]:
    import cv2

    height, width = picture.shape[:2]
    if width > _WIDEST:
        size = (_WIDEST, max(2, round(height * _WIDEST / width)))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
    if len(picture) < 2:
        picture = np.repeat(picture, 2, axis=0)
    levels = [picture]
    while min(levels[-1].shape[:2]) >= 8:
        height, width = levels[-1].shape[:2]
        half = cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, dtype=np.float32))
    return tuple(levels)


def _table(table: SkyPicture, u: Array, v: Array) -> Array:
    """(3, ...) bilinear values at u (columns) and v (rows) in [-1, 1]."""
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
