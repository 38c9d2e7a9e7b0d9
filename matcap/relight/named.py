"""Named scenes, and the scenes of animations and light sheets."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from matcap.errors import UsageError
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.plan import Plan
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    NAMED_LIGHTS,
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    Light,
    PointLight,
    RectangleLight,
    Scene,
    Surface,
    scene_from_light,
)

# A sphere between two softboxes in a dim room.
_STUDIO = Scene(
    film=Film(1024, 1024, exposure=1.0),
    camera=Camera(position=(0.0, 0.6, 5.0), fov=30.0),
    surface=Surface("sphere", size=2.0),
    lights=(
        RectangleLight((-2.2, 2.0, 2.4), (2.2, -2.0, -2.4), size=(1.6, 1.6), radiance=(5.0,) * 3),
        RectangleLight((2.8, 0.4, 1.0), (-2.8, -0.4, -1.0), size=(0.6, 2.4), radiance=(2.0,) * 3),
        EnvironmentLight(radiance=(0.05, 0.05, 0.06)),
    ),
)

# A floor under a low warm sun and a blue sky, from eye level.
_SUNSET = Scene(
    film=Film(1200, 800, exposure=0.5),
    camera=Camera(position=(0.0, -2.4, 1.3), target=(0.0, -0.1, 0.0), fov=42.0),
    surface=Surface("plane", size=3.0),
    lights=(
        DirectionalLight((-1.0, 0.5, 0.45), (5.5, 3.2, 1.6)),
        EnvironmentLight(radiance=(0.12, 0.16, 0.26)),
    ),
)

# A cylinder under two lamps, for the animation `turntable`.
_TURNTABLE = Scene(
    film=Film(640, 640, exposure=0.5),
    camera=Camera(position=(0.0, 1.2, 5.2), fov=28.0),
    surface=Surface("cylinder", size=1.8),
    lights=(
        PointLight((-2.0, 2.0, 3.0), (22.0, 22.0, 22.0)),
        PointLight((3.0, 0.5, 1.5), (7.0, 7.0, 8.0)),
        EnvironmentLight(radiance=(0.06, 0.06, 0.07)),
    ),
)

SCENES = {"studio": _STUDIO, "sunset": _SUNSET, "turntable": _TURNTABLE}
PRESETS = (*NAMED_LIGHTS, *SCENES)


def preset(name: str) -> Scene:
    """The scene of a name in PRESETS.

    Raises:
        UsageError: an unknown name.
    """
    if name in NAMED_LIGHTS:
        return scene_from_light(name)
    if name not in SCENES:
        raise UsageError.at(
            name, "there is no such scene", f"give a .toml file or {', '.join(PRESETS)}"
        )
    return SCENES[name]


def light_orbit(scene: Scene, frames: int) -> list[Scene]:
    """Scenes whose lights, but for environments, turn once about the z axis."""
    angles = [2.0 * math.pi * index / frames for index in range(frames)]
    return [
        replace(scene, lights=tuple(_turned(light, angle, 2) for light in scene.lights))
        for angle in angles
    ]


def turntable(scene: Scene, frames: int) -> list[Scene]:
    """Scenes whose surface turns once about the y axis: camera and lights turn the other way."""
    camera = scene.camera or Camera(position=(0.0, 0.0, 5.0))
    scenes = []
    for index in range(frames):
        angle = -2.0 * math.pi * index / frames
        lights = tuple(_turned(one, angle, 1) for one in scene.lights)
        scenes.append(replace(scene, camera=_turned(camera, angle, 1), lights=lights))
    return scenes


def sheet_lights(columns: int, rows: int) -> list[PointLight]:
    """Point lights of a light sheet, row by row, 2.5 plane units from the origin.

    Azimuths begin at the top and turn clockwise along a row; elevations go from 75 to 15 degrees,
    each row in the middle of its share.
    """
    lights = []
    for row in range(rows):
        elevation = math.radians(75.0 - 60.0 * (row + 0.5) / rows)
        for column in range(columns):
            azimuth = math.pi / 2.0 - 2.0 * math.pi * column / columns
            flat = 2.5 * math.cos(elevation)
            place = (
                flat * math.cos(azimuth),
                flat * math.sin(azimuth),
                2.5 * math.sin(elevation),
            )
            # exposing_intensity(place): white at the origin has radiance 1.
            strength = math.pi * 2.5**2 / math.sin(elevation)
            lights.append(PointLight(place, (strength, strength, strength)))
    return lights


Placed = TypeVar("Placed", bound=Camera | Light)


def _turned(placed: Placed, angle: float, axis: int) -> Placed:
    """A camera or light turned about the y (1) or z (2) axis; environments turn about y only."""
    turned: dict[str, Any] = {
        one.name: _rotated(getattr(placed, one.name), angle, axis)
        for one in fields(placed)
        if one.type == "Vector"
    }
    if isinstance(placed, EnvironmentLight) and axis == 1:
        turned = {"rotation": placed.rotation + math.degrees(angle)}
    return replace(placed, **turned)


def _rotated(
    vector: tuple[float, float, float], angle: float, axis: int
) -> tuple[float, float, float]:
    """A vector turned about y (1) or z (2), anticlockwise seen from the axis's tip."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = vector
    if axis == 1:
        return (c * x + s * z, y, c * z - s * x)
    return (c * x - s * y, s * x + c * y, z)


ANIMATIONS = {"light-orbit": light_orbit, "turntable": turntable}


def light_sheet(
    renderer: Renderer,
    columns: int,
    rows: int,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    effects: str = "auto",
) -> tuple[NDArray[np.float32], Plan]:
    """Render the material under each of sheet_lights(), instead of the scene's own lights.

    Returns:
        (rows H, columns W, 3) radiance, and the last picture's plan.
    """
    scene = renderer.scene
    renderings = [
        renderer.render(replace(scene, lights=(light,)), tolerance=tolerance, effects=effects)
        for light in sheet_lights(columns, rows)
    ]
    pictures = [one.radiance for one in renderings]
    lines = [np.hstack(pictures[i : i + columns]) for i in range(0, len(pictures), columns)]
    return np.vstack(lines), renderings[-1].plan
