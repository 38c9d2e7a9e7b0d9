"""Environment maps: radiance, irradiance, prefiltered by lobe width; directional albedo of
lobes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from matcap.files.environment import narrowed, read_picture
from matcap.relight.camera import Array, LatticePoint, Vec, lattice
from matcap.relight.loops.library import CEnvironment, KeptArrays
from matcap.relight.scene import EnvironmentLight

# Tables of the specular lobe's directional albedo, computed once a process.
#
# E(mu, alpha) is the albedo of D G / (4 (n.l)(n.v)), F = 1, at mu = n.v. With Schlick's Fresnel it
# is F0 scale + bias [karis2013]. Integrated over the lattice of visible normals, where the
# integrand is G2 / G1; errors are below 2e-4.

_SIZE = 64
_POINTS = 987
_FINE = 1024
# Grid of `lost`, for lookups of the nearest entry.
_ALPHAS, _COSINES = 512, 1024


@dataclass(frozen=True)
class Albedo:
    """Albedo tables: rows by perceptual roughness sqrt(alpha), columns by sqrt(mu), in [0, 1]."""

    bias: Array
    """(64, 64) integral weighted by Schlick's (1 - l.h)^5."""
    total: Array
    """(64, 64) E; scale = total - bias."""
    average: Array
    """(64,) cosine-weighted mean of `total` over the hemisphere, Eavg."""

    def rows(self, alpha: Array) -> Array:
        """Index of the first entry of an alpha's row in fine_total and fine_bias.

        The nearest of 1024 roughnesses; integers as float32, exact, for fast sums with mu.
        """
        rough = np.sqrt(np.asarray(alpha, dtype=np.float32))
        return np.rint(rough * np.float32(_FINE - 1)) * np.float32(_SIZE)

    def lookup(self, fine: Array, mu: Array, rows: Array) -> Array:
        """Values of fine_total or fine_bias at mu, linear in sqrt(mu); rows: of rows()."""
        x = np.sqrt(np.asarray(mu, dtype=np.float32)) * np.float32(_SIZE - 1)
        j = np.floor(x)
        value = np.take(fine, (rows + j).astype(np.intp), mode="clip")
        return value.real + (x - j) * value.imag

    @cached_property
    def fine_total(self) -> Array:
        """`total` interpolated to 1024 roughnesses, flattened by rows, as complex numbers.

        Real part: the value; imaginary part: the next value along mu minus it, so that a linear
        interpolation reads one number.
        """
        return _fine(self.total)

    @cached_property
    def fine_bias(self) -> Array:
        """`bias` in the layout of fine_total."""
        return _fine(self.bias)

    def near(self, alpha: Array) -> Array:
        """Index in `lost` of (nearest tabulated alpha, mu = 0); an integer, as float32."""
        return np.rint(alpha * np.float32(_ALPHAS - 1)) * np.float32(_COSINES)

    def missing(self, near: Array, mu: Array) -> Array:
        """1 - E(mu), the energy a single bounce loses: nearest entry of `lost`, within 1e-3."""
        index = mu * np.float32(_COSINES - 1) + (near + np.float32(0.5))
        return np.take(self.lost, index.astype(np.intp), mode="clip")

    @property
    def lost_step(self) -> float:
        """Offset in `lost` from mu = 0 to mu = 1."""
        return _COSINES - 1.0

    def average_at(self, near: Array) -> Array:
        """Eavg; near: of near()."""
        return np.take(self._averages, (near * np.float32(1.0 / _COSINES)).astype(np.intp))

    @cached_property
    def lost(self) -> Array:
        """1 - E, flat: 512 rows by alpha, 1024 columns by mu, both uniform in [0, 1]."""
        roughness = np.sqrt(np.linspace(0.0, 1.0, _ALPHAS))
        root_mu = np.sqrt(np.linspace(0.0, 1.0, _COSINES))
        total = _between(_between(self.total, roughness).T, root_mu).T
        return np.ascontiguousarray(np.maximum(1.0 - total, 0.0)).ravel()

    @cached_property
    def _averages(self) -> Array:
        return _between(self.average[:, None], np.sqrt(np.linspace(0.0, 1.0, _ALPHAS)))[:, 0]


def _between(table: Array, places: Array) -> Array:
    """A table's rows, uniform in [0, 1], linearly interpolated at (n,) places: (n, columns)."""
    y = places * (_SIZE - 1.0)
    i = np.minimum(y.astype(np.intp), _SIZE - 2)
    share = (y - i)[:, None]
    return (table[i] * (1.0 - share) + table[i + 1] * share).astype(np.float32)


def _fine(table: Array) -> Array:
    rows = _between(table, np.linspace(0.0, 1.0, _FINE))
    steps = np.diff(rows, axis=1, append=rows[:, -1:])
    return np.ascontiguousarray(rows + 1j * steps, dtype=np.complex64).ravel()


@lru_cache(maxsize=1)
def albedo() -> Albedo:
    """Compute the tables."""
    root_mu = np.linspace(0.0, 1.0, _SIZE)
    mu = np.maximum(root_mu**2, 1e-6)[None, :]
    alpha = np.maximum(np.linspace(0.0, 1.0, _SIZE) ** 2, 1e-6)[:, None]
    total, bias = np.zeros((2, _SIZE, _SIZE))
    for point in lattice(_POINTS):
        weight, cosine = _visible(mu, alpha, point)
        total += weight
        bias += weight * np.clip(1.0 - cosine, 0.0, 1.0) ** 5
    # Eavg = integral of 2 E mu dmu; with mu = x^2 that is 4 E x^3 dx.
    fine = np.linspace(0.0, 1.0, 2001)
    integrand = np.stack([np.interp(fine, root_mu, row) for row in total]) * 4.0 * fine**3
    average = np.trapezoid(integrand, fine, axis=1)
    f = np.float32
    return Albedo(bias.astype(f), total.astype(f), np.asarray(average, dtype=f))


def _visible(mu: Array, alpha: Array, point: LatticePoint) -> tuple[Array, Array]:
    """G2 / G1 times the sample's weight, and v.h, of one sampled visible normal."""
    sine = np.sqrt(np.maximum(1.0 - mu * mu, 0.0))
    vx, vz = alpha * sine, mu
    length = np.sqrt(vx * vx + vz * vz)
    vx, vz = vx / length, vz / length
    z = (1.0 - point.u) * (1.0 + vz) - vz
    ring = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    hx, hy = alpha * (ring * point.cosine + vx), alpha * (ring * point.sine)
    hz = np.maximum(z + vz, 1e-12)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hz = hx / length, hz / length
    cosine = sine * hx + mu * hz
    n_dot_l = 2.0 * cosine * hz - mu
    a2 = alpha * alpha
    towards_view = np.sqrt(a2 + (1.0 - a2) * mu * mu)
    safe = np.maximum(n_dot_l, 1e-12)
    towards_light = np.sqrt(a2 + (1.0 - a2) * safe * safe)
    # G2 = 2 nl nv / (nl Av + nv Al), G1 = 2 nv / (nv + Av).
    ratio = safe * (mu + towards_view) / (safe * towards_view + mu * towards_light)
    return np.where(n_dot_l > 0.0, ratio, 0.0) * point.weight, cosine


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
