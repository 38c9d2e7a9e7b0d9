"""Scene files (TOML), every key checked; named scenes, animations and light sheets."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.files.settings import nearest
from matcap.relight.effects import DEFAULT_TOLERANCE
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
    light_name,
    scene_from_light,
)

# Read scene files (TOML): every key is checked, and an error names the first that is wrong.
#
# [film]     width, height, exposure, transfer
# [camera]   type, position, target, fov, scale
# [surface]  type, size, file, repeat, displacement
# [[light]]  type and the keys of its kind (see docs/reference/file-formats.md)
#
# Files that they name are relative to the scene file. Presets are in named.py.

_LARGEST_SIDE = 32768
_LARGEST_EXPONENT = 20.0  # of vignetting, as in material files


class _Fault(Exception):
    """Expected kind of a value, such as "a number"; the reader completes the sentence."""


Checked = Callable[[Any], Any]


def read_scene(path: str | Path) -> Scene:
    """Read a scene file.

    Raises:
        MatcapError: missing, not TOML, an unknown or missing key, a value of the wrong type or out
            of range.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise MatcapError.at(path, "no such file", "check the path") from error
    except (OSError, UnicodeDecodeError) as error:
        raise MatcapError.at(
            path, "this is not a readable text file", "give a TOML scene file"
        ) from error
    return parse_scene(text, where=str(path), folder=path.parent)


def parse_scene(text: str, *, where: str = "scene", folder: Path = Path(".")) -> Scene:
    """The scene of TOML text; `folder` is what its files are relative to.

    Raises:
        MatcapError: as read_scene.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise MatcapError.at(
            where, f"this is not TOML ({str(error).rstrip('.')})", "correct the file"
        ) from error
    read = _Reader(where, folder)
    read.only(document, ("film", "camera", "surface", "light"), "")
    film = read.table(document.get("film", {}), "[film]", _FILM)
    surface = read.table(document.get("surface", {}), "[surface]", _SURFACE)
    if surface.get("type") == "mesh" and "file" not in surface:
        raise read.fault("[surface]", "a mesh needs its file", 'add file = "shoe.obj"')
    if "file" in surface and surface.get("type") != "mesh":
        raise read.fault("[surface]", "file belongs to a mesh", 'set type = "mesh"')
    camera = None
    if "camera" in document:
        table = read.table(document["camera"], "[camera]", _CAMERA)
        camera = Camera(**table)
        if math.dist(camera.position, camera.target) == 0.0:
            raise read.fault("[camera]", "position and target are the same", "move one of them")
    lights = document.get("light", [])
    if not isinstance(lights, list):
        raise read.fault("[light]", "lights are a list", "write [[light]]")
    return Scene(
        film=Film(**film),
        camera=camera,
        surface=Surface(**surface),
        lights=tuple(_light(read, entry, i) for i, entry in enumerate(lights, start=1)),
    )


@dataclasses.dataclass(frozen=True)
class _Reader:
    where: str
    folder: Path

    def fault(self, place: str, what: str, remedy: str) -> MatcapError:
        return MatcapError.at(f"{self.where} {place}".strip(), what, remedy)

    def only(self, table: Mapping[str, Any], known: tuple[str, ...], place: str) -> None:
        for key in table:
            if key not in known:
                raise self.fault(place, f"unknown key '{key}'", nearest(key, known))

    def table(
        self, table: object, place: str, checks: Mapping[str, Checked], ignore: tuple[str, ...] = ()
    ) -> dict[str, Any]:
        """The table's values, each through the check of its key, but for the keys in `ignore`."""
        if not isinstance(table, dict):
            raise self.fault(place, "this is not a table", "write its keys below its heading")
        self.only(table, (*ignore, *checks), place)
        values = {}
        for key, value in table.items():
            if key in ignore:
                continue
            try:
                values[key] = checks[key](value)
            except _Fault as fault:
                raise self.fault(place, f"{key} = {value!r} is wrong", f"give {fault}") from fault
        if "file" in values:
            values["file"] = self.folder / values["file"]
        return values


def _light(read: _Reader, entry: object, number: int) -> Light:
    place = f"[[light]] {number}"
    if not isinstance(entry, dict):
        raise read.fault(place, "this is not a table", "write its keys below [[light]]")
    kind = entry.get("type")
    if not isinstance(kind, str) or kind not in _LIGHTS:
        what = "a light needs a type" if kind is None else f"unknown type {kind!r}"
        raise read.fault(place, what, nearest(str(kind), _LIGHTS))
    make = _LIGHTS[kind]
    values = read.table(entry, place, _checks(make), ignore=("type",))
    missing = [
        field.name
        for field in dataclasses.fields(make)
        if field.default is dataclasses.MISSING and field.name not in values
    ]
    if missing:
        raise read.fault(place, f"a {kind} light needs {' and '.join(missing)}", "add it")
    if kind == "environment" and ("file" in values) == ("radiance" in values):
        raise read.fault(
            place, "an environment needs either file or radiance", "give exactly one of them"
        )
    if kind == "rectangle" and _parallel(values["normal"], values.get("up", (0.0, 1.0, 0.0))):
        raise read.fault(place, "up is along the normal", "give an up that is not")
    return make(**values)


def _number(
    says: str = "a number", holds: Callable[[float], bool] = lambda number: True
) -> Checked:
    """A check of finite numbers that `holds`; `says` is the expected kind."""

    def check(value: Any) -> float:  # noqa: ANN401
        finite = isinstance(value, int | float) and math.isfinite(value)
        if isinstance(value, bool) or not finite:
            raise _Fault("a number")
        if not holds(value):
            raise _Fault(says)
        return float(value)

    return check


def _numbers(
    count: int,
    example: str,
    says: str = "",
    holds: Callable[[tuple[float, ...]], bool] = lambda numbers: True,
) -> Checked:
    """A check of lists of `count` numbers, as the example shows, that `holds`."""

    def check(value: Any) -> tuple[float, ...]:  # noqa: ANN401
        if not isinstance(value, list) or len(value) != count:
            raise _Fault(example)
        numbers = tuple(_any(number) for number in value)
        if not holds(numbers):
            raise _Fault(says)
        return numbers

    return check


_any = _number()
_positive = _number("a number above 0", lambda number: number > 0.0)
_at_least_0 = _number("a number of at least 0", lambda number: number >= 0.0)
_angle = _number("an angle between 0 and 179 degrees", lambda number: 0.0 < number < 179.0)
_exponent = _number(
    f"a number from -{_LARGEST_EXPONENT:g} to {_LARGEST_EXPONENT:g}",
    lambda number: abs(number) <= _LARGEST_EXPONENT,
)
_THREE = "three numbers such as [0.0, 1.0, 2.0]"
_vector = _numbers(3, _THREE)
_direction = _numbers(3, _THREE, "a direction that is not zero", any)
_colour = _numbers(3, _THREE, "three numbers of at least 0", lambda colour: min(colour) >= 0.0)
_place = _numbers(2, "two numbers such as [0.0, 0.2]")


def _side(value: Any) -> int:  # noqa: ANN401
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= _LARGEST_SIDE:
        raise _Fault(f"a whole number from 1 to {_LARGEST_SIDE}")
    return value


def _one_of(*names: str) -> Checked:
    def check(value: Any) -> str:  # noqa: ANN401
        if value not in names:
            raise _Fault(" or ".join(f'"{name}"' for name in names))
        return str(value)

    return check


def _sides(value: Any) -> tuple[float, float]:  # noqa: ANN401
    """A rectangle's sides; one number is a square."""
    sides = value if isinstance(value, list) else [value, value]
    if len(sides) != 2:
        raise _Fault("one number or two")
    return _positive(sides[0]), _positive(sides[1])


def _file(value: Any) -> Path:  # noqa: ANN401
    if not isinstance(value, str) or not value or "\0" in value:
        raise _Fault("a file name")
    return Path(value)


def _parallel(a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
    dot = sum(x * y for x, y in zip(a, b, strict=True))
    return bool(dot * dot >= (1.0 - 1e-9) * sum(x * x for x in a) * sum(y * y for y in b))


# The check of a key: by its name, or else by the type of its field.
_BY_NAME: dict[str, Checked] = {
    "fov": _angle,
    "up": _direction,
    "direction": _direction,
    "normal": _direction,
    "vignetting": _exponent,
    "vignetting_quartic": _exponent,
    "vignetting_centre": _place,
    "radius": _positive,
    "repeat": _positive,
    "displacement": _at_least_0,
    "scale": _at_least_0,
}
_BY_TYPE: dict[str, Checked] = {
    "int": _side,
    "float": _any,
    "float | None": _positive,
    "tuple[float, float]": _sides,
    "Vector": _vector,
    "Colour": _colour,
    "Path | None": _file,
}


def _checks(kind: type[Film | Camera | Surface | Light]) -> dict[str, Checked]:
    choices = get_type_hints(kind)
    return {
        field.name: _BY_NAME.get(field.name)
        or _BY_TYPE.get(str(field.type))
        or _one_of(*get_args(choices[field.name]))
        for field in dataclasses.fields(kind)
    }


_FILM, _SURFACE = _checks(Film), _checks(Surface)
_CAMERA = _checks(Camera) | {"scale": _positive}  # a factor of an environment may be 0
_LIGHTS: dict[str, type[Light]] = {light_name(kind): kind for kind in get_args(Light)}


# Named scenes, and the scenes of animations and light sheets.


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
            name, "there is no such scene", nearest(name, PRESETS, "or a .toml file")
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
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[NDArray[np.float32], Plan]:
    """Render the material under each of sheet_lights(), instead of the scene's own lights.

    `progress` is called with the share done, in [0, 1], after each.

    Returns:
        (rows H, columns W, 3) radiance, and the last picture's plan.
    """
    scene = renderer.scene
    renderings = []
    for number, light in enumerate(sheet_lights(columns, rows), 1):
        lit = replace(scene, lights=(light,))
        renderings.append(renderer.render(lit, tolerance=tolerance, effects=effects))
        progress(number / (columns * rows))
    pictures = [one.radiance for one in renderings]
    lines = [np.hstack(pictures[i : i + columns]) for i in range(0, len(pictures), columns)]
    return np.vstack(lines), renderings[-1].plan
