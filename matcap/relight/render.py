"""Maps in a scene to a picture."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.relight.block import ShadingContext
from matcap.relight.brightness import check_lights, too_bright
from matcap.relight.budget import Budget
from matcap.relight.camera import View, view_of
from matcap.relight.clock import Clock
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.effects.environment import samples_for
from matcap.relight.environment_map import Environment, environment_of
from matcap.relight.horizons import Horizons
from matcap.relight.plan import EffectChoice, Plan, make_plan, parse_choice, radiance_tolerance
from matcap.relight.relief import Relief
from matcap.relight.sampling import Sampler
from matcap.relight.scene import EnvironmentLight, Film, Scene, Surface, scene_from_light
from matcap.relight.scene_bounds import gather
from matcap.relight.shade import shade
from matcap.relight.surfaces.shape import Shape, shape_of
from matcap.relight.tally import TILE, Tally
from matcap.relight.texture import Texture

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

# Pixels shaded together: so many that what each block costs to begin with does not count.
_BLOCK = 32768
# Top, bottom, left and right; half open.
Cut = tuple[int, int, int, int]
Item = TypeVar("Item")
OnShare = Callable[[float], None]
# Effects that are decided tile by tile.
BY_TILES = ("area", "environment", "parallax", "shadows", "visibility", "interreflection")
# Texels that a material is read across at most; beyond that it repeats.
_LARGEST_READ = 8192
# How often the material's longer side its height may span: a ray crosses as many texels.
_TALLEST = 10.0


class MapSource(Protocol):
    """A material: something that maps of any size can be read from."""

    @property
    def texel_size(self) -> float:
        """In plane units."""
        ...

    def maps(self, width: int, height: int, *, seed: int, x: int, y: int) -> MapSet:
        """The rectangle whose left top texel is (x, y)."""
        ...


@dataclass(frozen=True)
class Rendering:
    """A picture and how it came about."""

    radiance: NDArray[np.float32]
    """(H, W, 3) float32, linear Rec.709; 0 where there is no surface."""
    plan: Plan
    """Which effects ran, why, and what each took."""
    film: Film
    """Of the picture."""
    seconds: float
    """In all."""
    tally: Tally
    """Which tiles each effect ran in."""


def relight(
    source: MapSet | MapSource | Texture,
    scene: Scene | str = "top",
    *,
    seed: int = 0,
    tolerance: float = DEFAULT_TOLERANCE,
    effects: str = "auto",
) -> NDArray[np.float32]:
    """A picture of a material in a scene.

    Args:
        source: maps, or a material to read them from.
        scene: the scene, or what scene_from_light takes.
        seed: the realisation read from a material.
        tolerance: what leaving out effects may change at most, in code values of the film from 0
            to 1; half an 8-bit step by default. A smaller one also mirrors surroundings in more
            directions.
        effects: what parse_choice takes: auto, all, none, "+x,-y".

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
    """A material on a surface before a camera, ready for any lights.

    What does not depend on the lights (reading the material, its pyramid, its horizons) is kept
    from one picture to the next, which is what animations and light sheets live on.
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
        self._skies: dict[EnvironmentLight, Environment] = {}
        self._shapes: dict[tuple[object, Surface], tuple[View, Shape]] = {}

    @property
    def film(self) -> Film:
        """The picture's."""
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
        """One picture.

        Args:
            scene: another camera, film or lights than the renderer was made for; its surface must
                be the same.
            tolerance, effects: see relight().
            progress: hears of the share of the picture that is done, block by block.

        Raises:
            MatcapError: a light too bright for single precision, or what relight() raises.
        """
        start = perf_counter()
        scene = scene or self.scene
        check_lights(scene.lights)
        film = scene.film or self.film
        choice = parse_choice(effects) if isinstance(effects, str) else effects
        view, shape = self._seen(scene, film)
        skies = tuple(self._sky(one) for one in scene.lights if isinstance(one, EnvironmentLight))
        region, footprint = shape.region(view, self.relief)
        footprint *= scene.surface.repeat / self.texture.texel_size
        limits = gather(scene, self.texture, view, region, footprint, skies)
        # A lens that brightens corners brightens what is left out there, too.
        judged = replace(film, exposure=film.exposure + math.log2(view.brightest))
        plan = make_plan(limits, radiance_tolerance(tolerance, judged), choice)
        clock, tally = Clock(), Tally(view.size)
        adaptive = choice.start != "all" and any(plan.on(effect) for effect in BY_TILES)
        context = ShadingContext(
            scene,
            self.sampler,
            self.relief,
            plan,
            skies,
            self._horizons(plan, adaptive=adaptive),
            clock,
            samples_for(tolerance),
            Budget(plan.left(tolerance, judged), judged, plan.running) if adaptive else None,
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
        _in_parallel(block, blocks, lambda done: progress(done / len(blocks)))
        if not all(np.isfinite(row).all() for row in picture):
            raise too_bright(scene.lights)
        done = plan.done(clock.seconds, tally.shares())
        return Rendering(picture, done, film, perf_counter() - start, tally)

    def _seen(self, scene: Scene, film: Film) -> tuple[View, Shape]:
        key = ((scene.camera, film.width, film.height), scene.surface)
        if key not in self._shapes:
            shape = shape_of(scene.surface, self.texture)
            view = view_of(scene.camera, film, shape.framed(film))
            self._shapes = {key: (view, shape.seen_by(view))}
        return self._shapes[key]

    def _sky(self, light: EnvironmentLight) -> Environment:
        if light not in self._skies:
            flat = self.scene.surface.type == "plane"
            sky = environment_of(light)
            self._skies[light] = sky.above_plane() if flat else sky
        return self._skies[light]

    def _horizons(self, plan: Plan, *, adaptive: bool) -> Horizons | None:
        sends = plan.on("interreflection")
        if not sends and not plan.on("visibility"):
            return None
        self.relief.horizons.prepare(sends=sends and adaptive, fine=sends)
        return self.relief.horizons


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
    """Raise MatcapError for heights that rays would have to be followed through for ever."""
    relief, extent = texture.extremes.relief * surface.displacement, max(texture.extent)
    if not relief <= _TALLEST * extent:
        raise MatcapError(
            f"the material's height spans {relief:.2g} plane units, over {extent:.2g} across",
            remedy=f"give the surface a displacement below {_TALLEST * extent / relief:.1g}",
        )


def _covers(texture: Texture, surface: Surface) -> bool:
    """Whether one piece of the material covers the surface, so that no border meets another."""
    side = (surface.size or 0.0) * surface.repeat
    return surface.type == "plane" and side <= min(texture.extent) * (1.0 + 1e-6)


def _needed(scene: Scene) -> tuple[float, float]:
    """Width and height of material that the camera can see, in plane units of the surface."""
    size = scene.surface.size or 2.0
    film = scene.film or Film(1, 1)
    if scene.surface.type == "plane" and scene.camera is None:
        return size, size * min(1.0, film.height / film.width)
    if scene.surface.type in ("sphere", "cylinder"):
        # Once around from the side that is seen; half of it upwards on a sphere.
        return 3.1416 * size, size * (1.5708 if scene.surface.type == "sphere" else 1.0)
    return size, size


def _blocks(size: tuple[int, int], *, whole_tiles: bool) -> Iterator[Cut]:
    """Rectangles of a picture of some size, of about so many pixels."""
    width, height = size
    columns = TILE * max(1, _BLOCK // TILE**2) if whole_tiles else width
    rows = TILE if whole_tiles else max(1, _BLOCK // width)
    for top in range(0, height, rows):
        for left in range(0, width, columns):
            yield top, min(top + rows, height), left, min(left + columns, width)


def _in_parallel(
    work: Callable[[Item], None],
    items: Iterable[Item],
    on_progress: Callable[[int], None] = lambda _done: None,
) -> None:
    """Work on all items, on all cores; report how many are done, in order."""
    pool = ThreadPoolExecutor(_workers())
    try:
        for index, _ in enumerate(pool.map(work, items)):
            on_progress(index + 1)
    finally:
        # An interruption waits for no more than what has begun.
        pool.shutdown(cancel_futures=True)


def _workers() -> int:
    """Cores this process may use."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    if limit.isdigit() and int(limit) > 0:
        return int(limit)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
