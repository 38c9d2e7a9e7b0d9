"""Render maps in a scene: plan by bounds, then shade blocks of pixels in parallel."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import perf_counter
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.example.example import Example
from matcap.field.plane import Rectangle
from matcap.files.color import srgb_decode, srgb_picture
from matcap.files.threads import workers
from matcap.relight.block import Block, Hits, Round, ShadingContext, shape_of
from matcap.relight.camera import Array, view_of
from matcap.relight.effects import (
    DEFAULT_TOLERANCE,
    Bound,
    area,
    direct,
    environment,
    multiscatter,
    relief,
)
from matcap.relight.effects.environment import samples_for
from matcap.relight.environment_map import Environment, environment_of
from matcap.relight.plan import TILE, Budget, Plan, SceneBounds, Step, Tally, gather
from matcap.relight.relief import Horizons, Relief
from matcap.relight.scene import (
    EnvironmentLight,
    Film,
    RectangleLight,
    Scene,
    SphereLight,
    Surface,
    check_lights,
    too_bright,
)
from matcap.relight.texture import Sampler, SurfaceSample, Texture

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

# Table of all effects, in the order in which plans list them.
#
# A new effect is a file in effects/ and an entry here: its bound, and `move` (before the material
# is looked up) or `add` (after all lights). Effects with neither are terms of the lights' loops.


@dataclass(frozen=True)
class Effect:
    """An effect: its bound, and the stage in which it acts."""

    bound: Callable[[SceneBounds], Bound]
    """Upper bound on the change from leaving it out."""
    move: Callable[[Relief, Hits], tuple[Hits, Array]] | None = None
    """Displaces hits; returns them and the height there."""
    add: Callable[[Block], None] | None = None
    """Adds radiance to a block after all lights."""


EFFECTS: Mapping[str, Effect] = {
    "diffuse": Effect(direct.diffuse_bound),
    "specular": Effect(direct.specular_bound),
    "falloff": Effect(direct.falloff_bound),
    "area": Effect(area.bound),
    "environment": Effect(environment.bound),
    "filtering": Effect(relief.filtering_bound),
    "parallax": Effect(relief.parallax_bound, move=relief.move),
    "shadows": Effect(relief.shadows_bound),
    "visibility": Effect(relief.visibility_bound),
    "interreflection": Effect(relief.interreflection_bound, add=relief.add_interreflection),
    "multiscatter": Effect(multiscatter.bound),
}


# Decide which effects run, from upper bounds on what leaving each out could change.
#
# Effects are left out in the order of their bounds, as long as these add up to no more than the
# tolerance; the picture then differs by no more than that from one with all effects. The tolerance
# is in code values of the film (default: half an 8-bit step). It becomes a radiance by its value on
# the sRGB curve at 0: the curve is concave with f(0) = 0, so |f(a) - f(b)| <= f(|a - b|).


@dataclass(frozen=True)
class EffectChoice:
    """The user's choice: a start ("auto", "all" or "none") and effects forced on or off."""

    start: str = "auto"
    forced: Mapping[str, bool] = field(default_factory=dict)


def parse_choice(text: str) -> EffectChoice:
    """Parse `--effects`: "all", "none", "+x,-y", or both: "none,+diffuse".

    Raises:
        UsageError: an unknown effect, or one without + or -.
    """
    start, forced = "auto", dict[str, bool]()
    for index, part in enumerate(part.strip() for part in text.split(",")):
        if index == 0 and part in ("auto", "all", "none"):
            start = part
            continue
        sign, name = part[:1], part[1:]
        if sign not in ("+", "-") or name not in EFFECTS:
            near = [*difflib.get_close_matches(part.lstrip("+-"), EFFECTS, n=1), "name"][0]
            remedy = f"give all, none, or +{near} or -{near} (of {', '.join(EFFECTS)})"
            raise UsageError.at("--effects", f"'{part}' is not an effect to switch", remedy)
        forced[name] = sign == "+"
    return EffectChoice(start, forced)


def radiance_tolerance(tolerance: float, film: Film) -> float:
    """Radiance whose code value, after exposure, is the tolerance."""
    if film.transfer == "linear":
        return tolerance / film.gain
    return float(srgb_decode(np.array(tolerance))) / film.gain


def make_plan(limits: SceneBounds, tolerance: float, choice: EffectChoice) -> Plan:
    """Choose the effects that run.

    Args:
        limits: extremes of the scene, from which each effect computes its bound.
        tolerance: largest sum of the bounds of effects left out, in radiance.
        choice: start, and effects that the user forced on or off.
    """
    bounds = {name: effect.bound(limits) for name, effect in EFFECTS.items()}
    forced, left, off = choice.forced, tolerance, set()
    if choice.start == "auto":
        free = [effect for effect in EFFECTS if effect not in forced]
        for effect in sorted(free, key=lambda name: bounds[name].radiance):
            left -= bounds[effect].radiance
            if left < 0.0:
                break
            off.add(effect)
    steps = []
    for effect, bound in bounds.items():
        reason = bound.reason
        if effect in forced:
            reason = f"as asked for ({reason})"
        elif choice.start != "auto":
            reason = f"{choice.start} as asked for ({reason})"
        on = forced.get(effect, choice.start != "none" and effect not in off)
        steps.append(Step(effect, on, bound.radiance, reason, spends=effect in off))
    return Plan(tuple(steps), tolerance)


# Radiance of a block of pixels: displace hits, look up the material, add lights, add effects.
#
# The loops of matcap.relight.loops do the work. With a budget an effect runs in the pixels whose
# own bound exceeds it, without one in all.

# Effects that run in every pixel if they run at all.
_EVERYWHERE = ("diffuse", "specular", "falloff", "filtering", "parallax", "multiscatter")


def shade(context: ShadingContext, hits: Hits, tiles: Array) -> Array:
    """(3, rows, W) radiance of a block; 0 where rays miss the surface.

    Args:
        hits: intersections of the block's rays, (rows, W).
        tiles: (rows, W) index of the picture's tile of each pixel.
    """
    index = None if hits.seen is None else np.flatnonzero(hits.seen)
    with np.errstate(over="ignore", invalid="ignore"):  # render.py names the light
        block = _block(context, hits, index, tiles)
        _light(block)
    if index is None:
        return block.total.reshape(3, *tiles.shape)
    picture = np.zeros((3, tiles.size), dtype=np.float32)
    picture[:, index] = block.total
    return picture.reshape(3, *tiles.shape)


def _block(context: ShadingContext, hits: Hits, index: Array | None, tiles: Array) -> Block:
    """Hits on the displaced surface and the material there, of the pixels in `index`."""
    plan, tally, sampler = context.plan, context.tally, context.sampler
    flat = hits.flat(index, tiles.shape)
    height: Array | None = None
    for name, effect in EFFECTS.items():
        if effect.move is not None and plan.on(name):
            with tally.timed(name):
                flat, height = effect.move(context.relief, flat)
    if height is None and plan.on("shadows"):
        height = context.relief.at(*flat.place)
    with tally.timed("filtering" if plan.on("filtering") else "reading"):
        if plan.on("filtering"):
            sample = sampler.read(flat.place, flat.footprint)
        elif index is None and height is None:
            # Unflattened places let the sampler see that pixels are texels: no interpolation.
            sample = _flattened(sampler.read(hits.place), tiles.shape)
        else:
            sample = sampler.read(flat.place)
    tiles = tiles.ravel() if index is None else tiles.reshape(-1)[index]
    return Block(context, flat, height, sample, tiles)


def _flattened(sample: SurfaceSample, shape: tuple[int, ...]) -> SurfaceSample:
    """The sample broadcast to a block, row by row."""

    def every(array: Array) -> Array:
        return np.broadcast_to(array, shape).ravel()

    x, y, z = (every(one) for one in sample.normal)
    return replace(
        sample,
        diffuse=tuple(every(one) for one in sample.diffuse),
        specular=tuple(every(one) for one in sample.specular),
        alpha=every(sample.alpha),
        normal=(x, y, z),
    )


def _light(block: Block) -> None:
    """Add every light, then the effects computed from their sum."""
    context, plan = block.context, block.plan
    for name in _EVERYWHERE:
        if plan.on(name):
            block.ran(name)
    # Environments last: the budget allows more where a pixel is already bright.
    for light in context.scene.lights:
        if isinstance(light, SphereLight | RectangleLight) and plan.on("area"):
            area.add(block, light)
        elif not isinstance(light, EnvironmentLight):
            direct.add(block, light)
    for one in context.environments:
        environment.add(block, one)
    for name, effect in EFFECTS.items():
        if effect.add is not None and plan.on(name):
            with context.tally.timed(name):
                effect.add(block)
    if not block.facing.all():
        block.total *= block.facing


# Render maps in a scene: plan, then blocks of pixels in parallel.

# Pixels shaded together: enough to make a block's fixed cost negligible.
_BLOCK = 32768
# Top, bottom, left and right of a rectangle of pixels, half open.
Cut = tuple[int, int, int, int]
OnShare = Callable[[float], None]
# Effects that may run in some tiles only.
BY_TILES = ("area", "environment", "parallax", "shadows", "visibility", "interreflection")
# Largest side of the rectangle read from a material, in texels; beyond that it repeats.
_LARGEST_READ = 8192
# Texels beyond what is seen that lookups read, farther than any horizon; and those left out on a
# side are a multiple of these, so that mip levels of even widths average the same texels.
_BEYOND, _GROUPED = 320, 64
# Largest height range over the material's longer side: rays cross proportionally many texels.
_TALLEST = 10.0


class MapSource(Protocol):
    """A material: maps of any rectangle can be read from it."""

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""

    def maps(self, width: int, height: int, *, seed: int, x: int, y: int) -> MapSet:
        """The rectangle whose left top texel is (x, y)."""


Source: TypeAlias = "MapSet | MapSource | Example | Texture"


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


class Renderer:
    """Renders one material in one scene.

    Keeps from picture to picture what does not depend on effects: the maps, their mip pyramid, the
    horizon maps.
    """

    def __init__(self, source: Source, scene: Scene, *, seed: int = 0) -> None:
        self.texture = _texture(source, scene, seed)
        self.scene = replace(scene, film=scene.film or Film(*self.texture.size))
        surface = scene.surface
        _check_relief(self.texture, surface)
        endless = self.texture.periodic or not _covers(self.texture, surface)
        self.sampler = Sampler(self.texture, surface.repeat, endless)
        self.relief = Relief(self.texture, surface.repeat, surface.displacement, endless)
        skies = any(isinstance(light, EnvironmentLight) for light in scene.lights)
        self._horizon_maps = Horizons(self.relief, skies=skies)

    @property
    def film(self) -> Film:
        """Size, exposure and transfer of the picture."""
        assert self.scene.film is not None
        return self.scene.film

    def render(
        self,
        *,
        tolerance: float = DEFAULT_TOLERANCE,
        effects: str = "auto",
        progress: OnShare = lambda _share: None,
    ) -> Rendering:
        """Render one picture.

        Args:
            tolerance: largest change that leaving out effects may make, in code values of the film,
                [0, 1]. A smaller one than the default also samples environments in more directions.
            effects: "auto", "all", "none", or effects forced on and off: "+shadows,-parallax".
            progress: called with the finished share of the picture, (0, 1], after each block.

        Raises:
            MatcapError: a light too bright for single precision, a file of the scene that is
                missing or broken, or an effect of no such name.
        """
        start = perf_counter()
        scene, film = self.scene, self.film
        check_lights(scene.lights)
        choice = parse_choice(effects)
        shape = shape_of(scene.surface, self.texture)
        view = view_of(scene.camera, film, shape.framed(film))
        region, footprint = shape.region(view, self.relief)
        footprint *= scene.surface.repeat / self.texture.texel_size
        limits = gather(scene, self.texture, view, region, footprint, self._environments)
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
            self._environments,
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

    @cached_property
    def _environments(self) -> tuple[Environment, ...]:
        lights = (one for one in self.scene.lights if isinstance(one, EnvironmentLight))
        made = tuple(environment_of(light) for light in lights)
        flat = self.scene.surface.type == "plane"
        return tuple(one.above_plane() for one in made) if flat else made

    def _horizons(self, plan: Plan, *, adaptive: bool) -> Horizons | None:
        bounces = plan.on("interreflection")
        if not bounces and not plan.on("visibility"):
            return None
        self._horizon_maps.prepare(coarse=bounces and adaptive, fine=bounces)
        return self._horizon_maps


def _texture(source: Source, scene: Scene, seed: int) -> Texture:
    if isinstance(source, Texture):
        return source
    if isinstance(source, Example):
        texel_size = source.exemplar.texel_size
        area = _needed(scene, texel_size)
        return Texture.from_stacked(source.maps(seed, area, None), texel_size)
    from matcap.brdf.maps import MapSet

    if isinstance(source, MapSet):
        return Texture.from_maps(source)
    area = _needed(scene, source.texel_size)
    maps = source.maps(area.width, area.height, seed=seed, x=area.x, y=area.y)
    return Texture.from_maps(maps)


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


def _needed(scene: Scene, texel_size: float) -> Rectangle:
    """The rectangle of the material to read for a scene, at most _LARGEST_READ texels a side.

    Of a round surface the columns that its camera cannot see are left out, as many on the left as
    on the right, so that the middle stays where it is.
    """
    kind, size = scene.surface.type, scene.surface.size or 2.0
    film, width, height = scene.film or Film(1, 1), size, size
    if kind == "plane" and scene.camera is None:
        height = size * min(1.0, film.height / film.width)
    elif kind != "plane":
        # Circumference, pi d; a sphere's from pole to pole is half of it.
        width, height = 3.1416 * size, size * (1.5708 if kind == "sphere" else 1.0)
    texels = scene.surface.repeat / texel_size
    across, down = (min(_LARGEST_READ, max(1, round(side * texels))) for side in (width, height))
    if kind == "plane" or scene.film is None or across == _LARGEST_READ:
        return Rectangle(0, 0, across, down)
    shape = Round(size / 2.0, kind == "cylinder")
    view = view_of(scene.camera, film, shape.framed(film))
    seen = shape.farthest_longitude(view) * shape.radius * texels + _BEYOND
    unseen = max(0, int(across / 2.0 - seen)) // _GROUPED * _GROUPED
    return Rectangle(unseen, 0, across - 2 * unseen, down)


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
    pool = ThreadPoolExecutor(workers())
    try:
        for done, _ in enumerate(pool.map(work, blocks), start=1):
            progress(done / len(blocks))
    finally:
        # After an interruption, wait for running items only.
        pool.shutdown(cancel_futures=True)


def encode(radiance: NDArray[np.float32], film: Film) -> NDArray[np.float32]:
    """Code values in [0, 1]: radiance times 2^exposure, clipped, through the transfer function."""
    light = radiance * np.float32(film.gain)
    return srgb_picture(light) if film.transfer == "srgb" else np.clip(light, 0.0, 1.0)
