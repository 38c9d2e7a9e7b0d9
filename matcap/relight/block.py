"""Ray-surface hits, and a block of pixels shaded together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcap.relight.camera import Array, Vec, add, dot, scale
from matcap.relight.effects import multiscatter
from matcap.relight.effects.multiscatter import albedo
from matcap.relight.environment_map import Environment
from matcap.relight.loops.library import CPixels, KeptArrays
from matcap.relight.plan import Budget, Plan, Tally
from matcap.relight.relief import Horizons, Relief
from matcap.relight.scene import Scene
from matcap.relight.texture import Sampler, SurfaceSample, between

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
        if self.plan.on("interreflection"):
            # Interreflection needs the same texels: one walk computes both.
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
