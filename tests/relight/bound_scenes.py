"""Scenes in which leaving one effect out changes as much of its bound as can be.

    python tests/relight/bound_scenes.py

prints, for each effect, the largest change it makes in them as a share of its own bound: above 1
the bound would be wrong, far below it is loose. Each scene is one corner of what the bound's
derivation allows: grazing mirrors, lights near the surface and low over it, uneven skies, relief
as steep as it is deep.
"""

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from relight_samples import flat

from matcap.brdf.maps import MapSet
from matcap.files.exr import write_exr
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    Light,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
    Surface,
)

Try = tuple[MapSet, Scene]
_FILM = Film(12, 9)


def scene(*lights: Light, camera: Camera | None = None, **surface: object) -> Scene:
    return Scene(_FILM, camera, Surface(**{"size": None, **surface}), lights)


def grazing(degrees: float, scale: float = 0.2) -> tuple[Camera, tuple[float, float, float]]:
    """A camera so low over the plane, and the direction that mirrors its view."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return Camera("orthographic", (4.0 * c, 0.0, 4.0 * s), (0.0, 0.0, 0.0), scale=scale), (-c, 0, s)


def boards(depth: float, low: float = 0.0, high: float = 1.0, **maps: float) -> MapSet:
    """Stripes four texels wide, every other one raised, of two albedos."""
    raised = (torch.arange(32) // 4 % 2).float().expand(1, 24, 32)
    plain = flat(**{"roughness": 1.0, "specular": 0.0, **maps})
    diffuse = (low + (high - low) * (1.0 - raised)).expand(3, 24, 32).contiguous()
    height = (depth * raised).contiguous()
    return MapSet(diffuse, plain.specular, plain.roughness, height, plain.texel_size, True)


def sky(folder: Path, radius: float) -> EnvironmentLight:
    """Black, but for a disc of so many degrees around +z."""
    rows, columns = np.mgrid[0.5:64.0, 0.5:128.0]
    polar, azimuth = rows * np.pi / 64, (columns / 128 - 0.5) * 2 * np.pi
    z = np.cos(azimuth) * np.sin(polar)
    picture = (z > math.cos(math.radians(radius))).astype(np.float32)[..., None].repeat(3, 2)
    file = folder / f"disc{radius:g}.exr"
    write_exr(file, picture, half=False)
    return EnvironmentLight(file)


def tries(folder: Path) -> dict[str, Iterator[Try]]:
    """By effect."""
    top = DirectionalLight((0.0, 0.0, 1.0))
    even = EnvironmentLight(radiance=(1.0, 1.0, 1.0))
    mirror = {f0: flat(diffuse=0.0, specular=f0, roughness=0.4) for f0 in (0.04, 1.0)}
    white = flat(diffuse=0.9, specular=0.0, roughness=1.0)
    metal = flat(diffuse=0.0, specular=1.0, roughness=1.0)

    def diffuse() -> Iterator[Try]:
        yield white, scene(top)
        yield white, scene(even)

    def specular() -> Iterator[Try]:
        camera, direction = grazing(2.0)
        for maps in mirror.values():
            yield maps, scene(DirectionalLight(direction), camera=camera)
        yield metal, scene(even)

    def falloff() -> Iterator[Try]:
        for place in ((0.7, 0.0, 0.3), (0.9, 0.6, 0.15), (0.0, 0.0, 0.5)):
            yield white, scene(PointLight(place))
            yield white, scene(SphereLight(place, 0.01, (1e3,) * 3))
        yield white, scene(PointLight((5.0, 0.0, 1.0), (25.0,) * 3))
        camera, _ = grazing(2.0)
        yield mirror[1.0], scene(PointLight((-1.2, 0.0, 0.03)), camera=camera)

    def area() -> Iterator[Try]:
        dull = flat(diffuse=0.9, specular=0.0, roughness=1.0)
        for size in (0.05, 0.5, 2.0):
            yield dull, scene(RectangleLight((0.0, 0.0, 0.6), (0.0, 0.0, -1.0), size=(size, size)))
            yield dull, scene(SphereLight((0.0, 0.0, 1.1), size / 2.0))
            # Half of it has set: what its middle gives is nothing.
            yield dull, scene(SphereLight((6.0, 0.0, 0.0), size / 2.0))
        shiny = flat(diffuse=0.0, specular=1.0, roughness=0.6)
        for size in (0.02, 0.1, 0.4):
            yield shiny, scene(SphereLight((0.0, 0.0, 1.0), size))

    def environment() -> Iterator[Try]:
        both = flat(diffuse=0.9, specular=1.0, roughness=0.1)
        for radius in (20.0, 40.0, 60.0):
            yield both, scene(sky(folder, radius))
        yield boards(0.3, 0.9, 0.9), scene(even)
        yield boards(3.0, 0.9, 0.9, specular=1.0), scene(even)

    def filtering() -> Iterator[Try]:
        far = Camera("orthographic", (0.0, 0.0, 4.0), (0.0, 0.0, 0.0), scale=8.0)
        yield boards(0.0), scene(top, camera=far)

    def parallax() -> Iterator[Try]:
        for degrees in (20.0, 45.0):
            yield boards(0.3), scene(top, camera=grazing(degrees, 1.0)[0])

    def shadows() -> Iterator[Try]:
        for up in (0.3, 1.0, 3.0):
            yield boards(0.6, 0.9, 0.9), scene(DirectionalLight((1.0, 0.0, up)))
            yield boards(0.6, 0.9, 0.9), scene(PointLight((2.0, 0.0, 2.0 * up)))

    def visibility() -> Iterator[Try]:
        for depth in (0.3, 2.0):
            yield boards(depth, 0.9, 0.9), scene(even)
            yield boards(depth, 0.9, 0.9, specular=1.0), scene(even)

    def interreflection() -> Iterator[Try]:
        for depth in (0.03, 0.1, 0.3, 1.0):
            yield boards(depth, 0.9, 0.9), scene(even)
            yield boards(depth, 0.9, 0.9), scene(DirectionalLight((0.3, 0.0, 1.0)))

    def multiscatter() -> Iterator[Try]:
        yield metal, scene(top)
        yield metal, scene(even)
        camera, direction = grazing(20.0)
        yield metal, scene(DirectionalLight(direction), camera=camera)

    makers = (
        diffuse, specular, falloff, area, environment, filtering, parallax, shadows, visibility,
        interreflection, multiscatter,
    )  # fmt: skip
    return {maker.__name__: maker() for maker in makers}


def share(effect: str, one: Try) -> float:
    """The largest change that leaving the effect out makes, over its bound."""
    maps, asked = one
    renderer = Renderer(maps, asked)
    whole = renderer.render(effects="all")
    without = renderer.render(effects=f"all,-{effect}").radiance
    bound = next(step.bound for step in whole.plan.steps if step.effect == effect)
    change = float(np.abs(whole.radiance - without).max())
    return change / bound if change else 0.0


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for effect, scenes in tries(Path(folder)).items():
            shares = [share(effect, one) for one in scenes]
            print(f"{effect:<16}{max(shares):.3f}  of {', '.join(f'{s:.3f}' for s in shares)}")


if __name__ == "__main__":
    main()
