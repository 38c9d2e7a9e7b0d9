"""How long Mitsuba 3 takes for the named scenes, to a picture with 1 % of noise.

The same camera, lights, film and maps: leather as a `principled` material with a normal map, on
Mitsuba's own sphere, cylinder or plane. Only direct light is asked of it, and the relief has
normals but no geometry: no parallax, shadows, visibility or bounces, all of which matcap's picture
has. So Mitsuba would take longer for the picture itself. Its noise is a pixel's deviation relative
to its own radiance, in the middle of all lit pixels, from the difference of two renderings; half of
them have more of it, glints ten times as much. It falls with the square root of the samples, so the
time at 1 % is extrapolated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np

from matcap.lab.bench.relight import leather, median_seconds
from matcap.relight.named import SCENES
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Colour,
    DirectionalLight,
    EnvironmentLight,
    Film,
    Light,
    PointLight,
    RectangleLight,
    Scene,
)
from matcap.relight.texture import Texture

_NOISE = 0.01
_SAMPLES = 16
# Median of the difference of two normal numbers of deviation 1.
_MEDIAN = 0.6745 * 2.0**0.5
# Of Mitsuba: needs no compiler, which not every machine has in a form that it can use.
_VARIANT = "scalar_rgb"


@dataclass(frozen=True)
class Rival:
    """One scene.

    Attributes:
        scene: its name.
        matcap: seconds of the processor.
        mitsuba: its seconds at 1 % noise.
        noise: at _SAMPLES samples a pixel.
    """

    scene: str
    matcap: float
    mitsuba: float
    noise: float


def against_mitsuba(
    *, width: int = 320, texels: int = 512, tell: Callable[[str], None] = lambda _line: None
) -> list[Rival]:
    """The named scenes, by matcap and by Mitsuba.

    Args:
        width: of the pictures, which are 4:3.
        texels: across the leather.
        tell: hears of every scene.

    Raises:
        ImportError: Mitsuba is not installed.
    """
    import mitsuba

    mitsuba.set_variant(_VARIANT)
    texture = leather(texels)
    found = []
    for name, given in SCENES.items():
        film = replace(given.film or Film(), width=width, height=width * 3 // 4)
        scene = replace(given, film=film)
        ours = median_seconds(lambda scene=scene: Renderer(texture, scene).render(), 3)  # type: ignore[misc]
        seconds, noise = _seconds(mitsuba, _described(mitsuba, scene, texture))
        found.append(Rival(name, ours, seconds, noise))
        tell(f"{name}: matcap {ours:.2f} s, Mitsuba {seconds:.2f} s")
    return found


def rivals_markdown(found: Sequence[Rival]) -> str:
    """The table."""
    lines = [
        f"| scene | matcap s | Mitsuba s at 1 % | times as long | noise of {_SAMPLES} samples |",
        "|---|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {one.scene} | {one.matcap:.2f} | {one.mitsuba:.1f} | {one.mitsuba / one.matcap:.0f} "
        f"| {100 * one.noise:.1f} % |"
        for one in found
    ]
    return "\n".join(lines)


def _seconds(mitsuba: Any, scene: Any) -> tuple[float, float]:  # noqa: ANN401
    """Seconds to 1 % of noise, and the noise at _SAMPLES samples."""
    np.array(mitsuba.render(scene, spp=1, seed=0))  # what is compiled is compiled once
    start = process_time()
    one, other = (np.array(mitsuba.render(scene, spp=_SAMPLES, seed=seed)) for seed in (1, 2))
    seconds = (process_time() - start) / 2.0
    mean = (one + other).mean(axis=-1) / 2.0
    apart = np.abs(one - other).mean(axis=-1)[mean > 0.0] / mean[mean > 0.0]
    noise = float(np.median(apart)) / _MEDIAN
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
    sensor = {
        "type": "perspective",
        "fov": camera.fov,
        "fov_axis": "larger",
        "to_world": transform().look_at(list(camera.position), list(camera.target), [0, 1, 0]),
        "film": {
            "type": "hdrfilm", "width": film.width, "height": film.height,
            "rfilter": {"type": "box"}, "pixel_format": "rgb",
        },
    }  # fmt: skip
    lights = {f"light{i}": _light(mitsuba, light) for i, light in enumerate(scene.lights)}
    return mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
            "sensor": sensor,
            "surface": {**shapes[surface.type], "bsdf": material},
            **lights,
        }
    )


def _light(mitsuba: Any, light: Light) -> dict[str, Any]:  # noqa: ANN401
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
    assert isinstance(light, RectangleLight)
    transform = mitsuba.ScalarTransform4f
    target = [p + n for p, n in zip(light.position, light.normal, strict=True)]
    place = transform().look_at(list(light.position), target, list(light.up))
    return {
        "type": "rectangle",
        "to_world": place @ transform().scale([light.size[0] / 2.0, light.size[1] / 2.0, 1.0]),
        "emitter": {"type": "area", "radiance": rgb(light.radiance)},
    }
