"""A block of pixels shaded together: its inputs and its accumulated radiance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcap.relight.budget import Budget
from matcap.relight.clock import Clock
from matcap.relight.effects import multiscatter
from matcap.relight.environment_map import Environment
from matcap.relight.horizons import Horizons
from matcap.relight.loops.library import KeptArrays
from matcap.relight.loops.structures import CPixels
from matcap.relight.plan import Plan
from matcap.relight.relief import Relief
from matcap.relight.sampling import Sampler, SurfaceSample, between
from matcap.relight.scene import Scene
from matcap.relight.surfaces.hits import Hits
from matcap.relight.tables import albedo
from matcap.relight.tally import Tally
from matcap.relight.vectors import Array, dot


@dataclass(frozen=True)
class ShadingContext:
    """What all blocks share."""

    scene: Scene
    """Lights and surface."""
    sampler: Sampler
    """The material on the surface."""
    relief: Relief
    """Its height."""
    plan: Plan
    """Which effects run."""
    skies: tuple[Environment, ...]
    """The environments, in the order of their lights."""
    horizons: Horizons | None
    """Of the relief, where ambient visibility or interreflection run."""
    clock: Clock
    """Of the effects."""
    samples: int
    """Directions in which surroundings are mirrored."""
    budget: Budget | None
    """What single pixels may leave out; None where everything runs everywhere."""
    tally: Tally
    """Which tiles effects run in."""


class Block:
    """Pixels, and their radiance while lights and effects add to it.

    Attributes:
        context: what all blocks share, and
        plan: its plan.
        hits: where the pixels are, (N,) arrays.
        column, row: the same on the material, in texels.
        height: of the relief there, where rays are cast from.
        sample: the material there.
        tiles: of the picture that each pixel is in.
        n_dot_v: cosines of the view, not negative.
        facing: which pixels face the camera.
        total: (3, N) radiance.
        flow: (9, N) vector irradiance of each colour; None if not needed.
        strength, share: of multiple scattering, (N,) a channel; empty without it.
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
        self.flow = np.zeros((9, tiles.size), dtype=np.float32) if bounces else None
        self.strength: list[Array] = []
        self.share: list[Array] = []
        if self.plan.on("multiscatter"):
            with context.clock.on("multiscatter"):
                self._near = albedo().near(sample.alpha)
                terms = [multiscatter.terms(f0, self._near, self.n_dot_v) for f0 in sample.specular]
                self.strength, self.share = ([one[k] for one in terms] for k in (0, 1))

    @property
    def adaptive(self) -> bool:
        """Whether single pixels may leave out what would not show."""
        return self.context.budget is not None

    @cached_property
    def open(self) -> Array:
        """(2, N) what of the surroundings is open, and how much of neighbours is seen."""
        horizons = self.context.horizons
        assert horizons is not None
        if self.plan.on("interreflection"):
            # What will be asked for anyway is walked to together.
            horizons.send(self.column, self.row, None, fine=not self.adaptive)
        else:
            horizons.see(self.column, self.row)
        return between(horizons.open, self.context.relief.texture.size, self.column, self.row)

    def ran(self, effect: str, where: Array | None = None) -> None:
        """Note that an effect ran, in all pixels or in some."""
        self.context.tally.ran(effect, self._all_tiles if where is None else self.tiles[where])

    @cached_property
    def _all_tiles(self) -> Array:
        """The tiles, once for each run of pixels in a tile."""
        return self.tiles[np.flatnonzero(np.diff(self.tiles, prepend=-1))]

    @cached_property
    def _as_c(self) -> tuple[CPixels, KeptArrays]:
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
        if self.flow is not None:
            pixels.flow = tuple(one.ctypes.data for one in self.flow)
        if self.strength:
            lost = albedo().lost
            pixels.strength, pixels.near = vector(self.strength), kept.of(self._near)
            pixels.lost, pixels.lost_size = kept.of(lost), lost.size
            pixels.lost_step = albedo().lost_step
        return pixels, kept

    @property
    def as_c(self) -> CPixels:
        """As a C structure (loops/structures.py)."""
        return self._as_c[0]
