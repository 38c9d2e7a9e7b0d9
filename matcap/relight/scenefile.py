"""Scenes of files (TOML, every key checked), of names, and of photographs.

The keys of `[film]`, `[camera]`, `[surface]` and each `[[light]]` are the fields of scene.py's
dataclasses. Files that they name are relative to the scene file.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import MISSING, fields
from functools import partial
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

from matcap.errors import MatcapError, UsageError
from matcap.files.settings import nearest
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
    Vector,
    light_name,
    scene_from_light,
)

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.flash.geometry import FlashSetup

_LARGEST_SIDE = 32768
_LARGEST_EXPONENT = 20.0  # of vignetting, as in material files
_LIGHTS: dict[str, type[Light]] = {light_name(kind): kind for kind in get_args(Light)}
SceneFault = Callable[[str, str], MatcapError]  # of what is wrong, and the remedy


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
    _check_keys(document, ("film", "camera", "surface", "light"), partial(MatcapError.at, where))

    def made(name: str, kind: type) -> Any:  # noqa: ANN401
        fault = partial(MatcapError.at, f"{where} [{name}]")
        return _made(kind, document.get(name, {}), fault, folder)

    lights = document.get("light", [])
    if not isinstance(lights, list):
        raise MatcapError.at(f"{where} [light]", "lights are a list", "write [[light]]")
    return Scene(
        film=made("film", Film),
        camera=made("camera", Camera) if "camera" in document else None,
        surface=made("surface", Surface),
        lights=tuple(
            _light(table, partial(MatcapError.at, f"{where} [[light]] {number}"), folder)
            for number, table in enumerate(lights, start=1)
        ),
    )


def _light(table: object, fault: SceneFault, folder: Path) -> Any:  # noqa: ANN401
    if not isinstance(table, dict):
        raise fault("this is not a table", "write its keys below [[light]]")
    name, values = table.get("type"), {key: table[key] for key in table if key != "type"}
    if not isinstance(name, str) or name not in _LIGHTS:
        what = "a light needs a type" if name is None else f"unknown type {name!r}"
        raise fault(what, nearest(str(name), _LIGHTS))
    if name == "environment" and ("file" in values) == ("radiance" in values):
        raise fault("an environment needs either file or radiance", "give exactly one of them")
    return _made(_LIGHTS[name], values, fault, folder)


def _made(kind: type, table: object, fault: SceneFault, folder: Path) -> Any:  # noqa: ANN401
    """The dataclass of a table, whose keys are its fields."""
    if not isinstance(table, dict):
        raise fault("this is not a table", "write its keys below its heading")
    _check_keys(table, [one.name for one in fields(kind)], fault)
    lacks = [one.name for one in fields(kind) if one.default is MISSING and one.name not in table]
    if lacks:
        what = f"a {light_name(kind)} light needs {' and '.join(lacks)}"
        raise fault(what, "add it")
    values = {}
    for key, value in table.items():
        values[key], expected = _typed(kind, key, value)
        if expected:
            raise fault(f"{key} = {value!r} is wrong", f"give {expected}")
        if isinstance(values[key], Path):
            values[key] = folder / values[key]
    made = kind(**values)
    if isinstance(made, Camera) and math.dist(made.position, made.target) == 0.0:
        raise fault("position and target are the same", "move one of them")
    if isinstance(made, RectangleLight) and _parallel(made.normal, made.up):
        raise fault("up is along the normal", "give an up that is not")
    return made


def _check_keys(table: dict[str, Any], known: Iterable[str], fault: SceneFault) -> None:
    for key in table:
        if key not in known:
            raise fault(f"unknown key '{key}'", nearest(key, known))


_EXAMPLES = {
    1: "a number", 2: "two numbers such as [0.0, 0.2]", 3: "three numbers such as [0.0, 1.0, 2.0]",
}  # fmt: skip
_SIGNED = ("a direction that is not zero", lambda *vector: any(vector))
_COLOUR = ("three numbers of at least 0", lambda *colour: min(colour) >= 0.0)
_POSITIVE = ("a number above 0", lambda *sides: min(sides) > 0.0)
_AT_LEAST_0 = ("a number of at least 0", lambda number: number >= 0.0)
_EXPONENT = (
    f"numbers from -{_LARGEST_EXPONENT:g} to {_LARGEST_EXPONENT:g}",
    lambda *numbers: max(map(abs, numbers)) <= _LARGEST_EXPONENT,
)
# What numbers of a field must be, and whether they are.
_LIMITS: dict[str, tuple[str, Callable[..., bool]]] = {
    "fov": ("an angle between 0 and 179 degrees", lambda number: 0.0 < number < 179.0),
    **dict.fromkeys(("up", "direction", "normal"), _SIGNED),
    **dict.fromkeys(("intensity", "irradiance", "radiance"), _COLOUR),
    **dict.fromkeys(("vignetting", "vignetting_quartic", "vignetting_colour"), _EXPONENT),
    **dict.fromkeys(("size", "radius", "repeat"), _POSITIVE),
    **dict.fromkeys(("displacement", "scale"), _AT_LEAST_0),
}


def _typed(kind: type, name: str, value: Any) -> tuple[Any, str]:  # noqa: ANN401
    """A field's value of a TOML value, and what is expected instead; "" where it is right."""
    hint = get_type_hints(kind)[name]
    hint = get_args(hint)[0] if isinstance(hint, UnionType) else hint
    if get_origin(hint) is Literal:
        words = get_args(hint)
        return value, "" if value in words else " or ".join(f'"{word}"' for word in words)
    if hint is Path:
        is_name = isinstance(value, str) and value and "\0" not in value
        return (Path(value), "") if is_name else (None, "a file name")
    if hint is int:
        fits = type(value) is int and 1 <= value <= _LARGEST_SIDE
        return value, "" if fits else f"a whole number from 1 to {_LARGEST_SIDE}"
    count = len(get_args(hint)) or 1
    single = [value] * count if name == "size" else [value]  # one side is a square's
    numbers = value if isinstance(value, list) and count > 1 else single
    finite = (type(number) in (int, float) and abs(number) < 1e300 for number in numbers)
    if len(numbers) != count or not all(finite):
        return None, _EXAMPLES[count]
    limits = _POSITIVE if (kind, name) == (Camera, "scale") else _LIMITS.get(name)
    if limits and not limits[1](*numbers):
        return None, limits[0]
    return float(numbers[0]) if count == 1 else tuple(float(number) for number in numbers), ""


def _parallel(a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
    dot = sum(x * y for x, y in zip(a, b, strict=True))
    return bool(dot * dot >= (1.0 - 1e-9) * sum(x * x for x in a) * sum(y * y for y in b))


# Named scenes.

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

# A cylinder under two lamps.
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


# The scene of a photograph: its camera and flash, for a picture to compare with it.
#
# The same geometry as matcap.flash.light. FlashSetup's intensity includes the exposure, so
# radiance 1 is the photograph's white.


def photographed_scene(setup: FlashSetup, film: Film, *, endless: bool) -> Scene:
    """The scene with the photograph's camera and its flash as a point light.

    Args:
        film: of the picture, with the photograph's aspect ratio.
        endless: extend the plane to all that the camera sees; else it is the maps' rectangle.
    """
    import torch

    from matcap.flash.geometry import camera_in_plane, setup_rotation, to_upright

    place, light = (_vector(to_upright(setup, one)) for one in camera_in_plane(setup))
    # `turned`: the photograph is a portrait, so its up is the landscape's left.
    above = [-1.0, 0.0, 0.0] if setup.turned else [0.0, 1.0, 0.0]
    up = _vector(
        to_upright(setup, setup_rotation(setup).T @ torch.tensor(above, dtype=torch.float64))
    )
    middle = _vector(to_upright(setup, torch.tensor([*setup.vignetting_centre, 0.0])))
    camera = Camera(
        "perspective",
        place,
        fov=setup.fov,
        up=up,
        vignetting=setup.vignetting,
        vignetting_quartic=setup.vignetting_quartic,
        vignetting_centre=(middle[0], middle[1]),
        vignetting_colour=setup.vignetting_colour,
    )
    surface = Surface(size=_seen(setup, film) if endless else None)
    return Scene(film, camera, surface, (PointLight(light, setup.intensity),))


def _seen(setup: FlashSetup, film: Film) -> float:
    """Side of a square around the origin that holds all that the picture shows of the plane."""
    import torch

    from matcap.flash.geometry import unproject

    long = max(film.width, film.height)
    x, y = film.width / long, film.height / long
    if setup.turned:
        x, y = y, x
    corners = torch.tensor([[-x, x, -x, x], [y, y, -y, -y]], dtype=torch.float64)
    return 2.0 * float(unproject(corners, setup)[:2].abs().max())


def _vector(tensor: Tensor) -> Vector:
    x, y, z = tensor.tolist()
    return x, y, z
