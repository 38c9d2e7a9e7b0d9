"""Whole scenes whose every number may be extreme."""

import tempfile
from pathlib import Path

import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
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
    Vector,
)
from stable.edges.swept import Swept, log_uniform

_PICTURE = Film(24, 18)  # of a scene


def scenes(g: np.random.Generator) -> Swept:
    """Any scene of any numbers: a picture of finite radiance, not negative, or one sentence."""
    with tempfile.TemporaryDirectory() as folder:
        scene = _scene(g, Path(folder))
        maps = _maps(g)
        effects = str(g.choice(["auto", "all"]))
        try:
            picture = Renderer(maps, scene).render(effects=effects).radiance
        except MatcapError as error:
            named = bool(error.what and error.remedy)
            return Swept(1, broken=not named, refused=named)
        except Warning as error:
            raise RuntimeError(f"{error} in {scene} of {maps.texel_size:.2g}") from error
    broken = int((~np.isfinite(picture) | (picture < 0.0)).sum())
    return Swept(picture.size, broken, where=f"{scene}" if broken else "")


def _maps(g: np.random.Generator) -> MapSet:
    """A few texels of anything between a mirror and chalk, a film and a cliff."""
    width, height = (int(side) for side in g.integers(1, 17, 2))

    def field(planes: int) -> torch.Tensor:
        ends = g.choice([0.0, 0.04, 0.5, 1.0], 2)
        drawn = ends.min() + np.ptp(ends) * g.random((planes, height, width))
        return torch.from_numpy(drawn).float()

    lift = float(log_uniform(g, 1e-12, 1e8) * g.integers(2))
    return MapSet(
        field(3), field(1), field(1), lift * field(1), float(log_uniform(g, 1e-6, 1e2)),
        periodic=bool(g.integers(2)),
    )  # fmt: skip


def _scene(g: np.random.Generator, folder: Path) -> Scene:
    kind = str(g.choice(["plane", "plane", "sphere", "cylinder"]))
    camera = None
    if g.integers(3):
        camera = Camera(
            "perspective" if g.integers(2) else "orthographic",
            _place(g), (0.0, 0.0, 0.0), float(g.uniform(0.1, 179.0)),
            float(log_uniform(g, 1e-6, 1e6)),
        )  # fmt: skip
    surface = Surface(
        kind,  # type: ignore[arg-type]
        float(log_uniform(g, 1e-4, 1e4)) if kind != "plane" or g.integers(2) else None,
        float(log_uniform(g, 1e-3, 1e3)),
        float(log_uniform(g, 1e-6, 1e6) * g.choice([0.0, 1.0])),
    )
    lights = tuple(_light(g, folder) for _ in range(int(g.integers(1, 4))))
    return Scene(_PICTURE, camera, surface, lights)


def _light(g: np.random.Generator, folder: Path) -> Light:
    red, green, blue = (
        float(c) for c in log_uniform(g, 1e-30, 1e30) * g.choice([0.0, 1.0, 1.0], 3)
    )
    colour = (red, green, blue)
    kind = int(g.integers(11)) // 2
    if kind == 0:
        return PointLight(_place(g), colour)
    if kind == 1:
        return DirectionalLight(_place(g), colour)
    if kind == 2:
        return SphereLight(_place(g), float(log_uniform(g, 1e-6, 1e6)), colour)
    if kind == 3:
        sides = log_uniform(g, 1e-6, 1e6, 2)
        return RectangleLight(
            _place(g), _place(g), _place(g), (float(sides[0]), float(sides[1])), colour
        )
    if kind == 4:
        return EnvironmentLight(radiance=colour)
    picture = np.full((16, 32, 3), g.choice([0.0, 1.0]), np.float32)
    picture[g.integers(16), g.integers(32)] = log_uniform(g, 1e-3, 1e30)
    file = folder / f"sky{g.integers(10**9)}.exr"
    write_exr(file, picture, half=False)
    return EnvironmentLight(file, float(log_uniform(g, 1e-6, 1e6)), float(g.uniform(-1e4, 1e4)))


def _place(g: np.random.Generator) -> Vector:
    """Anywhere, near, far, low, or straight above."""
    x, y, z = g.normal(size=3) * log_uniform(g, 1e-6, 1e6) * g.choice([0.0, 1e-6, 1.0, 1.0], 3)
    return float(x), float(y), float(abs(z)) + (0.0 if x or y or z else 1.0)
