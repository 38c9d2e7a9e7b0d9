"""`matcap-lab bench relight`: time of relighting, and what leaving effects out saves.

- *relight*: each scene by its plan (adaptive choice of effects) against all effects; and a second
  picture of the same surface, whose horizons are cached.
- *tolerances*: each scene at several tolerances, with all effects, and with diffuse light alone.
- *mitsuba*: the named scenes against Mitsuba 3, to a picture with 1 % of noise: the same camera,
  lights, film and maps, leather as a `principled` material with a normal map, on Mitsuba's own
  sphere, cylinder or plane. Mitsuba renders direct light alone, with normals but without geometry
  of the relief; matcap's picture has both, so the comparison favours Mitsuba.

Times are processor times summed over cores, so that other programs do not count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.srgb import srgb_encode
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.named import SCENES
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Camera,
    Colour,
    DirectionalLight,
    EnvironmentLight,
    Film,
    Light,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
    scene_from_light,
)
from matcap.relight.scenefile import read_scene
from matcap.relight.texture import Texture
from matcap_lab.experiment.page import Presentation
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment, in_turn
from matcap_lab.simulate.named import realise

MEGAPIXEL = "one megapixel"  # under one point light, flat
# Of the plan, in steps of 8 bits; the default is half of one.
TOLERANCES = (0.03, 0.125, 0.5, 2.0, 8.0, 32.0)
EVERYTHING = "all effects"

PLAN = Presentation(
    "Relighting",
    "Processor seconds by the plan, by all effects, and of the plan's next picture of the same "
    "surface; clock: by the wall. The plan leaves out what changes less than half an 8-bit step.",
    ("seconds", "effects"),
    picture=False,
)
TOLERANCE = Presentation(
    "Relighting: time against accuracy",
    "Processor seconds and the largest difference of codes from all effects at a 16th of the "
    "default tolerance, in 8-bit steps.",
    ("seconds", "steps"),
    least=0.01,
)
NOISE = (
    "Processor seconds; of Mitsuba to 1 % of noise: a pixel's deviation relative to its own "
    "radiance, in the middle of all lit pixels, from the difference of two renderings. It falls "
    "with the square root of the samples, so the time is extrapolated from 16 a pixel."
)

_LONG = 4.0  # seconds; of longer runs one is enough
_STEP = 1.0 / 255.0
_FINE = 16.0  # default tolerance over that of the reference
_NOISE = 0.01
_SAMPLES = 16
# Median of the difference of two normal numbers of deviation 1.
_MEDIAN = 0.6745 * 2.0**0.5
# Variant of Mitsuba that needs no compiler.
_VARIANT = "scalar_rgb"

Timed = Mapping[str, Value]  # times, as columns


@dataclass(frozen=True)
class LitScene:
    """A scene and its surface."""

    scene: Scene
    texture: Texture

    @cached_property
    def true(self) -> NDArray[np.float32]:
        """Reference radiance: all effects at a finer tolerance."""
        fine = DEFAULT_TOLERANCE / _FINE
        return Renderer(self.texture, self.scene).render(tolerance=fine, effects="all").radiance


def plan_experiment(scenes: Sequence[Path], repeats: int = 3) -> Experiment[LitScene, Timed]:
    """Every scene by its plan, by all effects, and the plan's next picture."""

    def megapixel() -> LitScene:
        scene = scene_from_light("top")
        return _lit(replace(scene, surface=replace(scene.surface, displacement=0.0)))

    def plan(lit: LitScene, _seed: int) -> Timed:
        running = len(Renderer(lit.texture, lit.scene).render().plan.running)
        return timed(lambda: Renderer(lit.texture, lit.scene).render(), repeats, effects=running)

    def everything(lit: LitScene, _seed: int) -> Timed:
        return timed(lambda: Renderer(lit.texture, lit.scene).render(effects="all"), repeats)

    def following(lit: LitScene, _seed: int) -> Timed:
        renderer = Renderer(lit.texture, lit.scene)
        renderer.render()
        return timed(renderer.render, repeats)

    return Experiment(
        "relight",
        {MEGAPIXEL: megapixel}
        | {name: partial(_lit, scene) for name, scene in chosen_scenes(scenes).items()},
        {
            "plan": Configuration(plan),
            EVERYTHING: Configuration(everything),
            "next picture": Configuration(following),
        },
        settings=(chosen_scenes(scenes), repeats),
        skips=lambda subject, name: subject == MEGAPIXEL and name == EVERYTHING,
    )


def tolerance_experiment(
    scenes: Sequence[Path], *, width: int = 256, texels: int = 512, repeats: int = 3
) -> Experiment[LitScene, Timed]:
    """Every scene at every tolerance, with all effects and with diffuse light alone.

    Pictures are `width` pixels wide, of leather of `texels` a side; of `repeats` the median counts.
    """
    points = {f"{steps:g} steps": ("tolerance", "auto", steps) for steps in TOLERANCES}
    points[EVERYTHING] = ("effects", "all", 0.5)
    points["diffuse alone"] = ("effects", "none,+diffuse,+falloff", 0.5)
    chosen = {name: _resized(scene, width) for name, scene in chosen_scenes(scenes).items()}

    def run(effects: str, steps: float, lit: LitScene, _seed: int) -> Timed:
        def render() -> NDArray[np.float32]:
            renderer = Renderer(lit.texture, lit.scene)
            return renderer.render(tolerance=steps * _STEP, effects=effects).radiance

        film = lit.scene.film or Film()
        off = np.abs(codes(render(), film) - codes(lit.true, film)).max() / _STEP
        return timed(render, repeats, steps=float(off))

    return Experiment(
        "tolerances",
        {name: partial(_lit, scene, texels) for name, scene in chosen.items()},
        {
            name: Configuration(partial(run, effects, steps), group)
            for name, (group, effects, steps) in points.items()
        },
        settings=(chosen, texels, repeats),
    )


def mitsuba_experiment() -> Experiment[LitScene, Timed]:
    """The named scenes, and a megapixel of a flat material, by matcap and by Mitsuba.

    Raises:
        MatcapError: Mitsuba is not installed.
    """
    try:
        import mitsuba
    except ImportError as error:
        raise MatcapError(
            "the comparison needs Mitsuba 3", remedy="pip install 'matcap[reference]'"
        ) from error
    mitsuba.set_variant(_VARIANT)

    def ours(lit: LitScene, _seed: int) -> Timed:
        return timed(lambda: Renderer(lit.texture, lit.scene).render(), 3)

    def theirs(lit: LitScene, _seed: int) -> Timed:
        seconds, noise = _seconds(mitsuba, _described(mitsuba, lit.scene, lit.texture))
        return {"seconds": seconds, "noise": noise}

    chosen = {
        name: replace(given, film=replace(given.film or Film(), width=320, height=240))
        for name, given in SCENES.items()
    }
    above = scene_from_light("top")
    flat = replace(above.surface, size=2.0, displacement=0.0)
    chosen[MEGAPIXEL] = replace(above, camera=Camera(), film=Film(1024, 1024), surface=flat)
    return Experiment(
        "mitsuba",
        {name: partial(_lit, scene, 512) for name, scene in chosen.items()},
        {"matcap": Configuration(ours), "Mitsuba to 1 % of noise": Configuration(theirs)},
    )


def timed(call: Callable[[], object], repeats: int, **others: float) -> Timed:
    """Median processor and wall time of a call, s, and other columns.

    Of a single run if that is long, else of `repeats` after one to warm up.
    """
    (clock,), (seconds,) = in_turn((call,), 1)
    if seconds <= _LONG:
        (clock,), (seconds,) = in_turn((call,), repeats)
    return {"seconds": seconds, "clock": clock, **{k: float(v) for k, v in others.items()}}


def chosen_scenes(scenes: Sequence[Path]) -> dict[str, Scene]:
    """Scenes by name, from files or names of built-in scenes; all built-in ones by default."""
    named = {path.stem: SCENES.get(str(path)) or read_scene(path) for path in scenes}
    return named or dict(SCENES)


def _lit(scene: Scene, texels: int = 1024) -> LitScene:
    """A scene of simulated leather, of `texels` a side, two plane units wide."""
    maps = realise("leather", texels, texels, 1, 2.0 / texels)
    return LitScene(scene, Texture.from_maps(maps))


def _resized(scene: Scene, width: int) -> Scene:
    film = scene.film or Film()
    height = max(1, round(width * film.height / film.width))
    return replace(scene, film=replace(film, width=width, height=height))


def codes(radiance: NDArray[np.float32], film: Film) -> NDArray[np.float64]:
    """Film codes of radiance without clipping, so that errors of highlights count."""
    light = radiance.astype(np.float64) * film.gain
    return light if film.transfer == "linear" else srgb_encode(light)


def _seconds(mitsuba: Any, scene: Any) -> tuple[float, float]:  # noqa: ANN401
    """Seconds to 1 % of noise, and the noise at _SAMPLES samples."""
    np.array(mitsuba.render(scene, spp=1, seed=0))  # what is compiled is compiled once
    start = process_time()
    one, other = (np.array(mitsuba.render(scene, spp=_SAMPLES, seed=seed)) for seed in (1, 2))
    seconds = (process_time() - start) / 2.0
    mean = (one + other).mean(axis=-1) / 2.0
    difference = np.abs(one - other).mean(axis=-1)[mean > 0.0] / mean[mean > 0.0]
    noise = float(np.median(difference)) / _MEDIAN
    return seconds * (noise / _NOISE) ** 2, noise


def _described(mitsuba: Any, scene: Scene, texture: Texture) -> Any:  # noqa: ANN401
    transform = mitsuba.ScalarTransform4f
    camera, film, surface = scene.camera, scene.film, scene.surface
    assert camera is not None and film is not None and surface.size is not None
    radius = surface.size / 2.0
    # How often the material repeats around and up.
    around = {"plane": surface.size, "sphere": 2 * np.pi * radius, "cylinder": 2 * np.pi * radius}
    up = {"plane": surface.size, "sphere": np.pi * radius, "cylinder": surface.size}
    repeats = around[surface.type] / texture.extent[0], up[surface.type] / texture.extent[1]
    uv = transform().scale([*repeats, 1.0])

    def bitmap(array: Any) -> dict[str, Any]:  # noqa: ANN401
        pixels = mitsuba.Bitmap(np.ascontiguousarray(np.moveaxis(array, 0, -1)))
        return {"type": "bitmap", "bitmap": pixels, "raw": True, "to_uv": uv}

    material = {
        "type": "normalmap",
        "normalmap": bitmap(0.5 + 0.5 * texture.normal),
        "bsdf": {
            "type": "principled",
            "base_color": bitmap(texture.diffuse),
            "roughness": bitmap(texture.roughness),
        },
    }
    shapes = {
        "plane": {"type": "rectangle", "to_world": transform().scale([radius, radius, 1.0])},
        "sphere": {"type": "sphere", "radius": radius},
        "cylinder": {
            "type": "cylinder", "p0": [0, -radius, 0], "p1": [0, radius, 0], "radius": radius,
        },
    }  # fmt: skip
    sensor = mitsuba_sensor(mitsuba, camera, film)
    lights = {f"light{i}": mitsuba_light(mitsuba, light) for i, light in enumerate(scene.lights)}
    return mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
            "sensor": sensor,
            "surface": {**shapes[surface.type], "bsdf": material},
            **lights,
        }
    )


def mitsuba_sensor(mitsuba: Any, camera: Camera, film: Film) -> dict[str, Any]:  # noqa: ANN401
    """Mitsuba's description of a perspective camera; pixels are averages."""
    look_at = mitsuba.ScalarTransform4f().look_at
    return {
        "type": "perspective",
        "fov": camera.fov,
        "fov_axis": "larger",
        "to_world": look_at(list(camera.position), list(camera.target), [0, 1, 0]),
        "film": {
            "type": "hdrfilm", "width": film.width, "height": film.height,
            "rfilter": {"type": "box"}, "pixel_format": "rgb",
        },
    }  # fmt: skip


def mitsuba_light(mitsuba: Any, light: Light) -> dict[str, Any]:  # noqa: ANN401
    """Mitsuba's description of a light; surroundings are those of one radiance."""

    def rgb(colour: Colour) -> dict[str, Any]:
        return {"type": "rgb", "value": list(colour)}

    if isinstance(light, PointLight):
        position = list(light.position)
        return {"type": "point", "position": position, "intensity": rgb(light.intensity)}
    if isinstance(light, DirectionalLight):
        direction = [-c for c in light.direction]
        return {"type": "directional", "direction": direction, "irradiance": rgb(light.irradiance)}
    if isinstance(light, EnvironmentLight):
        return {"type": "constant", "radiance": rgb(light.radiance)}
    shining = {"type": "area", "radiance": rgb(light.radiance)}
    if isinstance(light, SphereLight):
        centre = list(light.position)
        return {"type": "sphere", "center": centre, "radius": light.radius, "emitter": shining}
    assert isinstance(light, RectangleLight)
    transform = mitsuba.ScalarTransform4f
    target = [p + n for p, n in zip(light.position, light.normal, strict=True)]
    place = transform().look_at(list(light.position), target, list(light.up))
    return {
        "type": "rectangle",
        "to_world": place @ transform().scale([light.size[0] / 2.0, light.size[1] / 2.0, 1.0]),
        "emitter": shining,
    }
