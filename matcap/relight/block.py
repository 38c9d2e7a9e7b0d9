"""Surfaces, ray-surface hits, and a block of pixels shaded together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcap.relight.camera import Array, Vec, View, add, dot, scale, subtract, vec
from matcap.relight.effects import multiscatter
from matcap.relight.effects.multiscatter import albedo
from matcap.relight.environment_map import Environment
from matcap.relight.loops.library import CPixels, KeptArrays
from matcap.relight.plan import Budget, Plan, Tally, VisibleRegion
from matcap.relight.relief import Horizons, Relief
from matcap.relight.scene import Film, Scene, Surface
from matcap.relight.texture import Sampler, SurfaceSample, Texture, between

# Ray-surface intersections.

TangentFrame = tuple[Vec, Vec, Vec]


@dataclass(frozen=True)
class Hits:
    """Intersections of a block of pixels; arrays broadcast to (rows, W)."""

    point: Vec
    """Position in the scene."""
    frame: TangentFrame | None
    """Tangent, bitangent and normal of the undisplaced surface, unit vectors of the scene; None on
    the plane, where they are x, y and z."""
    place: tuple[Array, Array]
    """(u, v) on the material in plane units, (0, 0) in its middle."""
    to_view: Vec
    """Unit vector to the camera, in the material's frame."""
    seen: Array | None
    """(rows, W) False where the ray misses; None where all rays hit."""
    footprint: Array
    """Longer side of a pixel's footprint, in plane units."""

    def flat(self, index: Array | None, shape: tuple[int, ...]) -> Hits:
        """Flatten to (N,) arrays, row by row.

        Args:
            index: flat indices of the pixels to keep; None keeps all.
            shape: (rows, W) of the block.
        """

        def every(array: Array) -> Array:
            whole = np.broadcast_to(array, shape)
            return whole.ravel() if index is None else whole.reshape(-1)[index]

        def vector(one: Vec) -> Vec:
            return every(one[0]), every(one[1]), every(one[2])

        frame = self.frame and (vector(self.frame[0]), vector(self.frame[1]), vector(self.frame[2]))
        place = (every(self.place[0]), every(self.place[1]))
        footprint = every(self.footprint)
        return Hits(vector(self.point), frame, place, vector(self.to_view), None, footprint)


def to_frame(vector: Vec, frame: TangentFrame | None) -> Vec:
    """A vector of the scene in the tangent frame."""
    if frame is None:
        return vector
    return dot(vector, frame[0]), dot(vector, frame[1]), dot(vector, frame[2])


def to_scene(vector: Vec, frame: TangentFrame | None) -> Vec:
    """A vector of the tangent frame in the scene."""
    if frame is None:
        return vector
    x, y, z = (scale(axis, c) for axis, c in zip(frame, vector, strict=True))
    return add(add(x, y), z)


# Sphere and cylinder around the origin, seen from outside.
#
# (u, v) = (radius longitude, radius latitude or y), with 0 at +z: true to size on the equator,
# squeezed towards a sphere's poles. The cylinder is upright and open. Displacement moves lookups in
# the tangent plane; outlines stay smooth.

# Picture's short side over a curved surface's diameter, with the default camera.
_MARGIN = 1.25


@dataclass(frozen=True)
class Round:
    """A sphere, or an upright cylinder as high as it is wide."""

    radius: float
    cylinder: bool

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        sides = max(film.width, film.height) / min(film.width, film.height)
        return 2.0 * self.radius * _MARGIN * sides

    def farthest_longitude(self, view: View) -> float:
        """Largest |longitude| of what a camera may see: n . position > radius there, n the normal.

        A camera above a sphere's pole, or at infinity, sees some of all.
        """
        x, y, z = view.position
        across = math.hypot(x, z)
        nearest = self.radius**2 if self.cylinder else self.radius**2 - y**2
        if not view.perspective or nearest <= 0.0 or across**2 <= nearest:
            return math.pi
        return min(abs(math.atan2(x, z)) + math.acos(math.sqrt(nearest) / across), math.pi)

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        origin, direction = view.rays(top, bottom)
        # Seen along y, a cylinder is a circle.
        axes = np.array([1.0, 0.0 if self.cylinder else 1.0, 1.0])[:, None, None]
        o, d = origin * axes, direction * axes
        along, seen = _nearest((d * d).sum(0), (o * d).sum(0), (o * o).sum(0) - self.radius**2)
        point = origin + along * direction
        if self.cylinder:
            seen = seen & (np.abs(point[1]) <= self.radius)
            longitude, up = np.arctan2(point[0], point[2]), point[1]
            zero = np.zeros_like(longitude)
            sine, cosine = np.sin(longitude), np.cos(longitude)
            tangent, normal = np.stack([cosine, zero, -sine]), np.stack([sine, zero, cosine])
            bitangent = np.stack([zero, zero + 1.0, zero])
        else:
            normal = point / np.maximum(np.sqrt((point * point).sum(0)), 1e-30)
            longitude = np.arctan2(normal[0], normal[2])
            up = self.radius * np.arcsin(np.clip(normal[1], -1.0, 1.0))
            zero = np.zeros_like(longitude)
            tangent = np.stack([np.cos(longitude), zero, -np.sin(longitude)])
            bitangent = np.cross(normal, tangent, axis=0)
        frame = (_vec(tangent), _vec(bitangent), _vec(normal))
        to_view = to_frame(_vec(-direction), frame)
        pixel = view.pixel * (along if view.perspective else np.ones_like(along))
        footprint = (pixel / np.maximum(to_view[2], 1e-3)).astype(np.float32)
        # Rays that miss look up the middle of the material: any valid place.
        place = (np.where(seen, self.radius * longitude, 0.0), np.where(seen, up, 0.0))
        footprint = np.where(seen, footprint, np.float32(0.0))
        return Hits(_vec(point), frame, place, to_view, seen, footprint)

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points; footprints are unbounded towards the outline."""
        r = self.radius + max(abs(relief.low), abs(relief.high))
        return VisibleRegion((-r, -r, -r), (r, r, r), flat=False), math.inf


def _nearest(a: Array, half_b: Array, c: Array) -> tuple[Array, Array]:
    """The smaller root of a t^2 + 2 half_b t + c = 0, and where it is real and positive."""
    inside = half_b * half_b - a * c
    seen = (inside > 0.0) & (a > 1e-12)
    safe = np.where(seen, a, 1.0)
    along = (-half_b - np.sqrt(np.maximum(inside, 0.0))) / safe
    seen = seen & (along > 0.0)
    return np.where(seen, along, 1.0), seen


def _vec(array: Array) -> Vec:
    x, y, z = array.astype(np.float32)
    return x, y, z


@dataclass(frozen=True)
class Flat:
    """The plane z = 0, `extent` wide and high."""

    extent: tuple[float, float]

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        return max(self.extent)

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        if _frontal(view):
            distance = view.position[2] if view.perspective else 1.0
            across, down = view.screen(top, bottom)
            x = across * distance + view.position[0]
            y = down * distance + view.position[1]
            ahead = view.position[2] > 0.0
        else:
            origin, direction = view.rays(top, bottom)
            falling = direction[2] < -1e-9
            along = np.where(falling, -origin[2] / np.where(falling, direction[2], -1.0), -1.0)
            ahead = along > 0.0
            x, y = (np.where(ahead, origin[i] + along * direction[i], 0.0) for i in (0, 1))
        # Pixel centres on the border are inside.
        half_width, half_height = (side / 2.0 * (1.0 + 1e-9) for side in self.extent)
        seen = np.asarray(ahead) & (np.abs(x) <= half_width) & (np.abs(y) <= half_height)
        shape = (bottom - top, view.across[1] - view.across[0])
        point = (x.astype(np.float32), y.astype(np.float32), np.zeros((1, 1), dtype=np.float32))
        to_view, footprint = _seen_from(view, point)
        return Hits(
            point=point,
            frame=None,
            place=(x, y),
            to_view=to_view,
            seen=None if seen.all() else np.broadcast_to(seen, shape),
            footprint=footprint,
        )

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points, and the largest side of a pixel's footprint."""
        high = [side / 2.0 for side in self.extent]
        low = [-side for side in high]
        endless = Flat((math.inf, math.inf))
        rows = [endless.hits(view, row, row + 1) for row in (0, view.size[1] - 1)]
        if all(hits.seen is None for hits in rows):
            # The picture's rays fill a convex part of the plane: its corners bound it.
            for axis in (0, 1):
                places = [float(hits.place[axis].ravel()[i]) for hits in rows for i in (0, -1)]
                slack = 1e-6 * (high[axis] - low[axis])
                low[axis] = min(max(low[axis], min(places) - slack), high[axis])
                high[axis] = max(min(high[axis], max(places) + slack), low[axis])
        region = VisibleRegion((low[0], low[1], relief.low), (high[0], high[1], relief.high), True)
        if view.perspective and not _frontal(view):
            above = view.position[2]
            far = max(
                sum((np.array([x, y, 0.0]) - view.position) ** 2)
                for x in (low[0], high[0])
                for y in (low[1], high[1])
            )
            return region, float(view.pixel * far / above) if above > 0.0 else 0.0
        return region, float(rows[0].footprint.max())


def _seen_from(view: View, point: Vec) -> tuple[Vec, Array]:
    """Unit vectors from points of the plane to the camera, and sides of pixels' footprints."""
    if not view.perspective:
        x, y, z = (np.full((1, 1), c, dtype=np.float32) for c in -view.axes[2])
        return (x, y, z), np.full((1, 1), view.pixel / max(-view.axes[2][2], 1e-6), np.float32)
    offset = subtract(vec(tuple(view.position)), point)
    inverse = 1.0 / np.sqrt(dot(offset, offset))
    to_view = scale(offset, inverse)
    if _frontal(view):
        # The plane is parallel to the picture: one footprint for all pixels.
        return to_view, np.full((1, 1), view.pixel * view.position[2], dtype=np.float32)
    return to_view, view.pixel / inverse / np.maximum(to_view[2], np.float32(1e-6))


def _frontal(view: View) -> bool:
    """Whether the camera looks straight down, with the picture's sides along x and y."""
    return bool(np.abs(view.axes - np.diag([1.0, 1.0, -1.0])).max() < 1e-12)


def shape_of(surface: Surface, texture: Texture) -> Flat | Round:
    """The shape of a surface."""
    width, height = (side / surface.repeat for side in texture.extent)
    if surface.type == "plane":
        size = surface.size
        return Flat((width, height) if size is None else (size, size))
    return Round((surface.size or max(width, height)) / 2.0, surface.type == "cylinder")


# A block of pixels shaded together: its inputs and its accumulated radiance.
#
# N is the number of pixels; arrays are (N,) float32 unless stated otherwise.


@dataclass(frozen=True)
class ShadingContext:
    """Inputs that all blocks of a picture share."""

    scene: Scene
    """Lights and surface."""
    sampler: Sampler
    """Filtered lookups of the material."""
    relief: Relief
    """Height field of the surface."""
    plan: Plan
    """Effects that run."""
    environments: tuple[Environment, ...]
    """One for each environment light, in their order."""
    horizons: Horizons | None
    """Horizon maps, where ambient visibility or interreflection run."""
    samples: int
    """Sampled directions of the specular lobe under environments."""
    budget: Budget | None
    """Error each pixel may spend on leaving effects out; None runs every effect in every pixel."""
    tally: Tally
    """Notes the tiles in which effects run, and their seconds."""


class Block:
    """Pixels, and the radiance that lights and effects have added so far.

    Attributes:
        hits: intersections of the pixels' rays with the surface.
        column, row: the same on the material, in texels, float64.
        height: of the relief there, where shadow rays start; None without parallax and shadows.
        sample: the material there.
        tiles: index of the picture's tile of each pixel.
        n_dot_v: cosine between shading normal and view, clamped to 0.
        facing: bool, whether shading normal and surface face the camera.
        total: (3, N) radiance.
        vector_irradiance: (9, N) integral of radiance times unit direction, x, y, z of each colour
            in turn, in the material's frame; None without interreflection.
        strength, share: factors of multiple scattering (multiscatter.terms), one array a channel
            of F0; empty without it.
    """

    def __init__(
        self,
        context: ShadingContext,
        hits: Hits,
        height: Array | None,
        sample: SurfaceSample,
        tiles: Array,
    ) -> None:
        self.context, self.plan, self.hits, self.sample = context, context.plan, hits, sample
        self.column, self.row = context.sampler.texels(hits.place)
        self.tiles = tiles
        self.height = height
        self.n_dot_v = np.maximum(dot(sample.normal, hits.to_view), np.float32(0.0))
        self.facing: Array = (self.n_dot_v > 0.0) & (hits.to_view[2] > 0.0)
        self.total = np.zeros((3, tiles.size), dtype=np.float32)
        bounces = self.plan.on("interreflection")
        self.vector_irradiance = np.zeros((9, tiles.size), dtype=np.float32) if bounces else None
        self.strength: list[Array] = []
        self.share: list[Array] = []
        if self.plan.on("multiscatter"):
            with context.tally.timed("multiscatter"):
                self._near = albedo().near(sample.alpha)
                terms = [multiscatter.terms(f0, self._near, self.n_dot_v) for f0 in sample.specular]
                self.strength, self.share = ([one[k] for one in terms] for k in (0, 1))

    @property
    def adaptive(self) -> bool:
        """Whether effects may be left out pixel by pixel."""
        return self.context.budget is not None

    @cached_property
    def open(self) -> Array:
        """(2, N) sky view factor, and share of directions that meet relief (Horizons.open)."""
        horizons = self.context.horizons
        assert horizons is not None
        if self.plan.on("interreflection") and (not self.adaptive or horizons.shared):
            # Interreflection needs the same texels: one walk computes both, with the same bits.
            horizons.transfer(self.column, self.row, None, fine=not self.adaptive)
        else:
            horizons.compute(self.column, self.row)
        return between(horizons.open, self.context.relief.texture.size, self.column, self.row)

    def ran(self, effect: str, where: Array | None = None) -> None:
        """Note that an effect ran in all pixels, or in those that `where` indexes."""
        self.context.tally.ran(effect, self._all_tiles if where is None else self.tiles[where])

    @cached_property
    def _all_tiles(self) -> Array:
        """Tile index of every run of consecutive pixels in one tile."""
        return self.tiles[np.flatnonzero(np.diff(self.tiles, prepend=-1))]

    @cached_property
    def as_c(self) -> CPixels:
        """The block as a C structure (loops/library.py)."""
        kept, hits, sample = KeptArrays(), self.hits, self.sample

        def vector(arrays: tuple[Array, ...] | list[Array]) -> tuple[int, ...]:
            addresses = [kept.of(one) for one in arrays]
            return tuple(addresses * 3)[:3]

        pixels = CPixels(
            count=self.tiles.size,
            column=kept.of(self.column, np.float64),
            row=kept.of(self.row, np.float64),
            point=vector(hits.point),
            height=None if self.height is None else kept.of(self.height),
            view=vector(hits.to_view),
            normal=vector(sample.normal),
            n_dot_v=kept.of(self.n_dot_v),
            alpha=kept.of(sample.alpha),
            facing=kept.of(self.facing, np.uint8),
            diffuse=vector(sample.diffuse),
            specular=vector(sample.specular),
            total=tuple(one.ctypes.data for one in self.total),
        )
        if self.plan.on("shadows"):
            pixels.wide = kept.of(self.context.sampler.covered(hits.footprint))
        if hits.frame is not None:
            pixels.frame = tuple(kept.of(one) for axis in hits.frame for one in axis)
        if self.vector_irradiance is not None:
            pixels.vector_irradiance = tuple(one.ctypes.data for one in self.vector_irradiance)
        if self.strength:
            lost = albedo().lost
            pixels.strength, pixels.near = vector(self.strength), kept.of(self._near)
            pixels.lost, pixels.lost_size = kept.of(lost), lost.size
            pixels.lost_step = albedo().lost_step
        return kept.kept_by(pixels)
