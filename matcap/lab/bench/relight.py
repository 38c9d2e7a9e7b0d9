"""What relighting costs, and what leaving effects out saves.

Speed: one megapixel, one point light, flat. Saving: each scene with its automatic plan against
`--effects all`, both by the same loops; and the next picture of a sequence against the first, for
which horizons are known. Mitsuba, where it is installed: the time it takes to render a diffuse
plane under a rectangular light to the same error. Times are of the processor, all cores together,
so that other programs do not count; the megapixel also by the wall's clock.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from matcap.relight.named import SCENES
from matcap.relight.render import Renderer
from matcap.relight.scene import Film, RectangleLight, Scene, Surface, scene_from_light
from matcap.relight.scenefile import read_scene
from matcap.relight.texture import Texture

# Root mean square of half an 8-bit step: the error at which Mitsuba's time is taken.
_EQUAL_ERROR = 0.5 / 255.0
# Seconds beyond which one run is enough.
_LONG = 4.0


@dataclass(frozen=True)
class Saving:
    """One scene.

    Attributes:
        scene: its name.
        automatic: seconds with the automatic plan.
        everything: seconds with every effect.
        next: seconds of the plan's next picture of the same surface.
        running: how many of the effects the plan runs.
    """

    scene: str
    automatic: float
    everything: float
    next: float
    running: int

    @property
    def ratio(self) -> float:
        """How many times faster the plan is."""
        return self.everything / self.automatic


def megapixel_milliseconds(repeats: int = 15) -> tuple[float, float]:
    """1024 x 1024 pixels, one point light, flat: median by the wall's clock and the processor's."""
    texture = leather(1024)
    scene = scene_from_light("top")
    scene = replace(scene, surface=replace(scene.surface, displacement=0.0))
    renderer = Renderer(texture, scene)
    return (
        1e3 * median_seconds(renderer.render, repeats, perf_counter),
        1e3 * median_seconds(renderer.render, repeats),
    )


def savings(scenes: Sequence[Path], *, width: int | None = None, repeats: int = 3) -> list[Saving]:
    """Every scene, with the plan and with everything.

    Args:
        scenes: see chosen_scenes().
        width: of the pictures, instead of the scenes' own.
        repeats: of which the median counts; reading the maps is not counted, horizons are.
    """
    texture = leather(1024)
    found = []
    for name, scene in chosen_scenes(scenes):
        film = scene.film or Film()
        if width is not None:
            height = max(1, round(width * film.height / film.width))
            film = replace(film, width=width, height=height)
        scene = replace(scene, film=film)

        def automatic(scene: Scene = scene) -> object:
            return Renderer(texture, scene).render()

        def everything(scene: Scene = scene) -> object:
            return Renderer(texture, scene).render(effects="all")

        kept = Renderer(texture, scene)
        running = len(kept.render().plan.running)
        found.append(
            Saving(
                name,
                median_seconds(automatic, repeats),
                median_seconds(everything, repeats),
                median_seconds(kept.render, repeats),
                running,
            )
        )
    return found


def chosen_scenes(scenes: Sequence[Path]) -> list[tuple[str, Scene]]:
    """Names and scenes: of scene files, or of scenes that have names; all these without any."""
    named = [(path.stem, SCENES.get(str(path)) or read_scene(path)) for path in scenes]
    return named or list(SCENES.items())


def mitsuba_ratio(size: int = 256) -> dict[str, float]:
    """Time of Mitsuba 3 over matcap's, for the same picture at the same error.

    Mitsuba's error falls with the square root of its samples: its time at half an 8-bit step is
    extrapolated from 64 samples a pixel.

    Raises:
        ImportError: Mitsuba is not installed.
    """
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    light = RectangleLight(
        (0.6, 0.4, 1.4), (-0.6, -0.4, -1.4), size=(0.8, 0.6), radiance=(4.0,) * 3
    )
    scene = Scene(Film(size, size), None, Surface(displacement=0.0), (light,))
    renderer = Renderer(_grey(), scene)
    effects = "none,+diffuse,+falloff,+area"
    ours = median_seconds(lambda: renderer.render(effects=effects), 5)
    picture = renderer.render(effects=effects).radiance
    theirs = _mitsuba_scene(mitsuba, light, size)
    start = process_time()
    rough = np.array(mitsuba.render(theirs, spp=64))
    seconds = process_time() - start
    error = float(np.sqrt(np.mean((rough - picture) ** 2)))
    return {
        "matcap": ours,
        "mitsuba": seconds * (error / _EQUAL_ERROR) ** 2,
        "mitsuba at 64 samples": seconds,
        "its error there": error,
    }


def report(scenes: Sequence[Path]) -> dict[str, Any]:
    """All of it, for printing."""
    wall, processor = megapixel_milliseconds()
    found = savings(scenes)
    result: dict[str, Any] = {
        "megapixel_wall_ms": wall,
        "megapixel_processor_ms": processor,
        "scenes": [
            {
                "scene": one.scene,
                "automatic_s": one.automatic,
                "all_s": one.everything,
                "ratio": one.ratio,
                "next_s": one.next,
                "effects": one.running,
            }
            for one in found
        ],
        "median_ratio": statistics.median(one.ratio for one in found),
    }
    try:
        result["mitsuba"] = mitsuba_ratio()
    except ImportError:
        result["mitsuba"] = None
    return result


def table(result: dict[str, Any]) -> str:
    """The report as text."""
    wall, processor = result["megapixel_wall_ms"], result["megapixel_processor_ms"]
    lines = [
        f"one megapixel, one point light, flat: {wall:.1f} ms, {processor:.1f} ms of the processor",
        "",
    ]
    lines.append(f"{'scene':<14}{'effects':>8}{'plan s':>9}{'all s':>9}{'ratio':>8}{'next s':>9}")
    lines += [
        f"{one['scene']:<14}{one['effects']:>8}{one['automatic_s']:>9.3f}{one['all_s']:>9.3f}"
        f"{one['ratio']:>8.2f}{one['next_s']:>9.3f}"
        for one in result["scenes"]
    ]
    lines += [f"median ratio {result['median_ratio']:.2f}", ""]
    times = result["mitsuba"]
    if times is None:
        lines.append("Mitsuba is not installed: pip install mitsuba")
    else:
        lines.append(
            f"diffuse plane, rectangular light, to half an 8-bit step: matcap "
            f"{times['matcap']:.4f} s, Mitsuba {times['mitsuba']:.4f} s, "
            f"{times['mitsuba'] / times['matcap']:.1f} times as long "
            f"(from an error of {times['its error there']:.4f} after "
            f"{times['mitsuba at 64 samples']:.3f} s)"
        )
    return "\n".join(lines)


def median_seconds(
    call: Callable[[], object], repeats: int, clock: Callable[[], float] = process_time
) -> float:
    """Median seconds: of one run where runs are long, else of `repeats` after one to warm up."""
    times = []
    for _ in range(repeats + 1):
        start = clock()
        call()
        times.append(clock() - start)
        if times[0] > _LONG:
            return times[0]
    return statistics.median(times[1:])


def leather(size: int) -> Texture:
    """Simulated leather of so many texels a side, two plane units wide."""
    from matcap.lab.simulate.materials import realise

    return Texture.from_maps(realise("leather", size, size, 1, 2.0 / size))


def _grey() -> Texture:
    grey, none = np.full((3, 8, 8), 0.5, np.float32), np.zeros((2, 8, 8), np.float32)
    return Texture(grey, none[:1], grey[:1], none[:1], none, 0.25)


def _mitsuba_scene(mitsuba: Any, light: RectangleLight, size: int) -> Any:  # noqa: ANN401
    """The same diffuse plane under the same light; the light is out of the camera's way."""
    transform = mitsuba.ScalarTransform4f
    target = [p + n for p, n in zip(light.position, light.normal, strict=True)]
    place = transform().look_at(list(light.position), target, list(light.up))
    half = transform().scale([light.size[0] / 2.0, light.size[1] / 2.0, 1.0])
    return mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "hide_emitters": True},
            "sensor": {
                "type": "perspective",
                "fov": 45.0,
                "to_world": transform().look_at([0, 0, 2.41421356], [0, 0, 0], [0, 1, 0]),
                "film": {
                    "type": "hdrfilm",
                    "width": size,
                    "height": size,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                },
            },
            "ground": {
                "type": "rectangle",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}},
            },
            "light": {
                "type": "rectangle",
                "to_world": place @ half,
                "emitter": {
                    "type": "area",
                    "radiance": {"type": "rgb", "value": list(light.radiance)},
                },
            },
        }
    )
