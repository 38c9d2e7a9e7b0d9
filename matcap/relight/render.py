"""Render maps in a scene: plan, then blocks of pixels in parallel."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.memory import cores
from matcap.relight.block import ShadingContext
from matcap.relight.camera import View, view_of
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.effects.environment import samples_for
from matcap.relight.environment_map import Environment, environment_of
from matcap.relight.horizons import Horizons
from matcap.relight.plan import Budget, Plan
from matcap.relight.planning import EffectChoice, make_plan, parse_choice, radiance_tolerance
from matcap.relight.relief import Relief
from matcap.relight.sampling import Sampler
from matcap.relight.scene import (
    EnvironmentLight,
    Film,
    Scene,
    Surface,
    check_lights,
    scene_from_light,
    too_bright,
)
from matcap.relight.scene_bounds import gather
from matcap.relight.shade import shade
from matcap.relight.surfaces.hits import Shape
from matcap.relight.surfaces.shape import shape_of
from matcap.relight.tally import TILE, Tally
from matcap.relight.texture import Texture

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

# Pixels shaded together: enough to make a block's fixed cost negligible.
_BLOCK = 32768
# Top, bottom, left and right of a rectangle of pixels, half open.
Cut = tuple[int, int, int, int]
OnShare = Callable[[float], None]
# Effects that may run in some tiles only.
BY_TILES = ("area", "environment", "parallax", "shadows", "visibility", "interreflection")
# Largest side of the rectangle read from a material, in texels; beyond that it repeats.
_LARGEST_READ = 8192
# Largest height range over the material's longer side: rays cross proportionally many texels.
_TALLEST = 10.0


class MapSource(Protocol):
    """A material: maps of any rectangle can be read from it."""

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""

    def maps(self, width: int, height: int, *, seed: int, x: int, y: int) -> MapSet:
        """The rectangle whose left top texel is (x, y)."""


@dataclass(frozen=True)
class Rendering:
    """A picture, with the plan and the times of its rendering."""

    radiance: NDArray[np.float32]
    """(H, W, 3) float32, linear Rec.709; 0 where there is no surface."""
    plan: Plan
    """Effects that ran, with reasons and milliseconds."""
    film: Film
    """Size, exposure and transfer of the picture."""
    seconds: float
    """Wall-clock time of the rendering."""
    tally: Tally
    """Tiles in which each effect ran."""


def relight(
    source: MapSet | MapSource | Texture,
    scene: Scene | str = "top",
    *,
    seed: int = 0,
    tolerance: float = DEFAULT_TOLERANCE,
    effects: str = "auto",
) -> NDArray[np.float32]:
    """Render a material in a scene.

    Args:
        source: maps, or a material to read them from.
        scene: the scene, or a light as scene_from_light takes it: "top", "-1,1,2".
        seed: the realisation read from a material.
        tolerance: largest change that leaving out effects may make, in code values of the film,
            [0, 1]; half an 8-bit step by default. A smaller one also samples environments in more
            directions.
        effects: "auto", "all", "none", or effects forced on and off: "+shadows,-parallax".

    Returns:
        (H, W, 3) float32 radiance, linear Rec.709; 0 where there is no surface. Exposure and
        transfer of the film are not applied.

    Raises:
        MatcapError: a file of the scene is missing or broken, or an effect has no such name.
    """
    scene = scene_from_light(scene) if isinstance(scene, str) else scene
    renderer = Renderer(source, scene, seed=seed)
    return renderer.render(tolerance=tolerance, effects=effects).radiance


class Renderer:
    """Renders one material on one surface, under any cameras and lights.

    Keeps what does not depend on them from picture to picture: the maps, their mip pyramid, the
    horizon maps. Animations and light sheets gain by it.
    """

    def __init__(
        self, source: MapSet | MapSource | Texture, scene: Scene, *, seed: int = 0
    ) -> None:
        self.texture = _texture(source, scene, seed)
        self.scene = replace(scene, film=scene.film or Film(*self.texture.size))
        surface = scene.surface
        _check_relief(self.texture, surface)
        endless = self.texture.periodic or not _covers(self.texture, surface)
        self.sampler = Sampler(self.texture, surface.repeat, endless)
        self.relief = Relief(self.texture, surface.repeat, surface.displacement, endless)
        self._horizon_maps = Horizons(self.relief)
        self._environments: dict[EnvironmentLight, Environment] = {}
        self._shapes: dict[tuple[object, Surface], tuple[View, Shape]] = {}

    @property
    def film(self) -> Film:
        """Size, exposure and transfer of the picture, unless render() is given another scene."""
        assert self.scene.film is not None
        return self.scene.film

    def render(
        self,
        scene: Scene | None = None,
        *,
        tolerance: float = DEFAULT_TOLERANCE,
        effects: str | EffectChoice = "auto",
        progress: OnShare = lambda _share: None,
    ) -> Rendering:
        """Render one picture.

        Args:
            scene: camera, film and lights, where not the renderer's own; the surface must be the
                renderer's.
            tolerance, effects: see relight().
            progress: called with the finished share of the picture, (0, 1], after each block.

        Raises:
            MatcapError: a light too bright for single precision, or what relight() raises.
        """
        start = perf_counter()
        scene = scene or self.scene
        check_lights(scene.lights)
        film = scene.film or self.film
        choice = parse_choice(effects) if isinstance(effects, str) else effects
        view, shape = self._seen(scene, film)
        lights = (one for one in scene.lights if isinstance(one, EnvironmentLight))
        environments = tuple(self._environment(light) for light in lights)
        region, footprint = shape.region(view, self.relief)
        footprint *= scene.surface.repeat / self.texture.texel_size
        limits = gather(scene, self.texture, view, region, footprint, environments)
        # Vignetting below 0 brightens corners, and with them the error of effects left out.
        brightest = replace(film, exposure=film.exposure + math.log2(view.brightest))
        plan = make_plan(limits, radiance_tolerance(tolerance, brightest), choice)
        tally = Tally(view.size)
        adaptive = choice.start != "all" and any(plan.on(effect) for effect in BY_TILES)
        context = ShadingContext(
            scene,
            self.sampler,
            self.relief,
            plan,
            environments,
            self._horizons(plan, adaptive=adaptive),
            samples_for(tolerance),
            Budget(plan.left(tolerance, brightest), brightest, plan.running) if adaptive else None,
            tally,
        )
        picture = np.zeros((film.height, film.width, 3), dtype=np.float32)

        def block(place: Cut) -> None:
            top, bottom, left, right = place
            hits = shape.hits(view.part(left, right), top, bottom)
            if hits.seen is None or hits.seen.any():
                radiance = shade(context, hits, tally.of(*place))
                if view.vignetted:
                    radiance *= view.part(left, right).share(top, bottom)
                picture[top:bottom, left:right] = np.moveaxis(radiance, 0, -1)

        blocks = list(_blocks(view.size, whole_tiles=adaptive))
        _in_parallel(block, blocks, progress)
        if not all(np.isfinite(row).all() for row in picture):
            raise too_bright(scene.lights)
        done = plan.done(tally.seconds, tally.shares())
        return Rendering(picture, done, film, perf_counter() - start, tally)

    def _seen(self, scene: Scene, film: Film) -> tuple[View, Shape]:
        key = ((scene.camera, film.width, film.height), scene.surface)
        if key not in self._shapes:
            shape = shape_of(scene.surface, self.texture)
            view = view_of(scene.camera, film, shape.framed(film))
            self._shapes = {key: (view, shape.seen_by(view))}
        return self._shapes[key]

    def _environment(self, light: EnvironmentLight) -> Environment:
        if light not in self._environments:
            flat = self.scene.surface.type == "plane"
            environment = environment_of(light)
            self._environments[light] = environment.above_plane() if flat else environment
        return self._environments[light]

    def _horizons(self, plan: Plan, *, adaptive: bool) -> Horizons | None:
        bounces = plan.on("interreflection")
        if not bounces and not plan.on("visibility"):
            return None
        self._horizon_maps.prepare(coarse=bounces and adaptive, fine=bounces)
        return self._horizon_maps


def _texture(source: MapSet | MapSource | Texture, scene: Scene, seed: int) -> Texture:
    from matcap.brdf.maps import MapSet

    if isinstance(source, Texture):
        return source
    if isinstance(source, MapSet):
        return Texture.from_maps(source)
    width, height = _needed(scene)
    texels = scene.surface.repeat / source.texel_size
    across = min(_LARGEST_READ, max(1, round(width * texels)))
    down = min(_LARGEST_READ, max(1, round(height * texels)))
    return Texture.from_maps(source.maps(across, down, seed=seed, x=0, y=0))


def _check_relief(texture: Texture, surface: Surface) -> None:
    """Refuse a relief so tall that a ray would cross it for minutes.

    Raises:
        MatcapError: its range is above _TALLEST times the material's longer side.
    """
    relief, extent = texture.extremes.relief * surface.displacement, max(texture.extent)
    if not relief <= _TALLEST * extent:
        raise MatcapError(
            f"the material's heights span {relief:.2g} plane units, and it is {extent:.2g} wide",
            remedy=f"give the surface a displacement below {_TALLEST * extent / relief:.1g}",
        )


def _covers(texture: Texture, surface: Surface) -> bool:
    """Whether the material covers the surface without repeating."""
    side = (surface.size or 0.0) * surface.repeat
    return surface.type == "plane" and side <= min(texture.extent) * (1.0 + 1e-6)


def _needed(scene: Scene) -> tuple[float, float]:
    """Width and height of the material to read for a scene, in plane units of the surface."""
    size = scene.surface.size or 2.0
    film = scene.film or Film(1, 1)
    if scene.surface.type == "plane" and scene.camera is None:
        return size, size * min(1.0, film.height / film.width)
    if scene.surface.type in ("sphere", "cylinder"):
        # Circumference, pi d; a sphere's from pole to pole is half of it.
        return 3.1416 * size, size * (1.5708 if scene.surface.type == "sphere" else 1.0)
    return size, size


def _blocks(size: tuple[int, int], *, whole_tiles: bool) -> Iterator[Cut]:
    """Split a picture into rectangles of about _BLOCK pixels.

    Args:
        size: (width, height).
        whole_tiles: no rectangle ends inside a tile.
    """
    width, height = size
    columns = TILE * max(1, _BLOCK // TILE**2) if whole_tiles else width
    rows = TILE if whole_tiles else max(1, _BLOCK // width)
    for top in range(0, height, rows):
        for left in range(0, width, columns):
            yield top, min(top + rows, height), left, min(left + columns, width)


def _in_parallel(work: Callable[[Cut], None], blocks: list[Cut], progress: OnShare) -> None:
    """Call `work` on all blocks in threads; report the share finished, in the blocks' order."""
    pool = ThreadPoolExecutor(_workers())
    try:
        for done, _ in enumerate(pool.map(work, blocks), start=1):
            progress(done / len(blocks))
    finally:
        # After an interruption, wait for running items only.
        pool.shutdown(cancel_futures=True)


def _workers() -> int:
    """Number of threads: OMP_NUM_THREADS, else the cores this process may use."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    return int(limit) if limit.isdigit() and int(limit) > 0 else cores()
