"""`matcap-lab bench relight`: time of relighting, and what leaving effects out saves.

- *relight*: each scene by its plan (adaptive choice of effects) against all effects; and a second
  picture of the same surface, whose horizons are cached.
- *tolerances*: each scene at several tolerances, with all effects, and with diffuse light alone.

Times are processor times summed over cores, so that other programs do not count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.files.color import srgb_encode
from matcap.relight.effects import DEFAULT_TOLERANCE
from matcap.relight.render import Renderer
from matcap.relight.scene import Film, Scene, scene_from_light
from matcap.relight.scenefile import SCENES, read_scene
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
_LONG = 4.0  # seconds; of longer runs one is enough
_STEP = 1.0 / 255.0
_FINE = 16.0  # default tolerance over that of the reference
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
