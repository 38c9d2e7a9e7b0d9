"""Scenes: film, camera, surface and lights, as plain values.

Lengths are in plane units (half a photograph's long side), angles in degrees, colours linear
Rec.709. x points right, y up, z towards the camera; the plane is z = 0. scenefile.py reads files.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from matcap.errors import MatcapError, UsageError
from matcap.files.settings import BRIGHTEST, nearest

Vector = tuple[float, float, float]
Colour = tuple[float, float, float]

WHITE: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Film:
    """Size and encoding of the picture."""

    width: int = 1024
    """Width of the picture, pixels."""
    height: int = 768
    """Height of the picture, pixels."""
    exposure: float = 0.0
    """Exposure value, EV: encoded pictures are multiplied by 2^exposure; EXR radiance is not."""
    transfer: Literal["srgb", "linear"] = "srgb"
    """Transfer function of encoded pictures (PNG)."""

    @property
    def gain(self) -> float:
        """2^exposure: factor on radiance before encoding."""
        return 2.0**self.exposure


@dataclass(frozen=True)
class Camera:
    """Position and lens of the camera."""

    type: Literal["perspective", "orthographic"] = "perspective"
    """Either "perspective" or "orthographic"."""
    position: Vector = (0.0, 0.0, 1.0 / math.tan(math.radians(22.5)))
    """Position of the camera, plane units."""
    target: Vector = (0.0, 0.0, 0.0)
    """The point in the middle of the picture."""
    fov: float = 45.0
    """Field of view across the long side, degrees; perspective only."""
    scale: float = 1.0
    """Half the width that the long side shows, in plane units; orthographic only."""
    up: Vector = (0.0, 1.0, 0.0)
    """Direction that points upwards in the picture."""
    vignetting: float = 0.0
    """Vignetting v: the lens transmits exp(-(v r^2 + q r^4)), r = 1 in the corners of a 4:3
    picture. May be negative."""
    vignetting_quartic: float = 0.0
    """Vignetting q, see `vignetting`."""
    vignetting_centre: tuple[float, float] = (0.0, 0.0)
    """Where r is 0, image coordinates: x right, y up, the long side from -1 to 1."""
    vignetting_colour: Vector = (0.0, 0.0, 0.0)
    """Added to v in red, green and blue."""


@dataclass(frozen=True)
class Surface:
    """Geometry that the material covers."""

    type: Literal["plane", "sphere", "cylinder"] = "plane"
    """A plane, sphere or cylinder around the origin."""
    size: float | None = 2.0
    """Side of a plane, diameter of a sphere or cylinder (also the cylinder's height), in plane
    units; None is the maps' own extent."""
    repeat: float = 1.0
    """Factor by which the material is shrunk on the surface: 2 fits twice as many texels along a
    side."""
    displacement: float = 1.0
    """Factor on the height in parallax, shadows, visibility and interreflection. Shading normals
    do not change: 0 keeps bump shading and drops the geometry of the relief."""


@dataclass(frozen=True)
class PointLight:
    """A point light: irradiance falls off with distance squared."""

    position: Vector
    """Position of the light, plane units."""
    intensity: Colour = WHITE
    """Radiant intensity."""


@dataclass(frozen=True)
class DirectionalLight:
    """A light at infinite distance."""

    direction: Vector
    """Towards the light; any length."""
    irradiance: Colour = WHITE
    """Irradiance of a surface that faces the light."""


@dataclass(frozen=True)
class SphereLight:
    """A sphere that emits the same radiance everywhere, in all directions."""

    position: Vector
    """Position of its centre, plane units."""
    radius: float
    """Radius of the sphere, plane units."""
    radiance: Colour = WHITE
    """Emitted radiance."""


@dataclass(frozen=True)
class RectangleLight:
    """A rectangle that emits the same radiance everywhere on its front."""

    position: Vector
    """Position of its centre, plane units."""
    normal: Vector
    """Direction that its front faces; any length."""
    up: Vector = (0.0, 1.0, 0.0)
    """Direction of its second side, made perpendicular to the normal."""
    size: tuple[float, float] = (1.0, 1.0)
    """Sides across and along `up`, in plane units."""
    radiance: Colour = WHITE
    """Emitted radiance."""


@dataclass(frozen=True)
class EnvironmentLight:
    """An environment map, or the same radiance from all directions.

    The map is latitude-longitude, seen from inside: top +y, middle +z (which the plane faces),
    right half towards -x.
    """

    file: Path | None = None
    """EXR or HDR file; None for a constant."""
    scale: float = 1.0
    """Factor on the radiance."""
    rotation: float = 0.0
    """Degrees about +y, anticlockwise from above."""
    radiance: Colour = WHITE
    """Radiance of a constant environment."""


Light = PointLight | DirectionalLight | SphereLight | RectangleLight | EnvironmentLight


def light_name(kind: type[Light]) -> str:
    """The type of a light in scene files: "point", "directional"..."""
    return kind.__name__.removesuffix("Light").lower()


@dataclass(frozen=True)
class Scene:
    """Film, camera, surface and lights."""

    film: Film | None = field(default_factory=Film)
    """None is one pixel a texel of the maps."""
    camera: Camera | None = None
    """None is a camera straight above, 45 degrees across the long side, at the distance that frames
    the surface's long side."""
    surface: Surface = field(default_factory=Surface)
    """Geometry that the material covers."""
    lights: tuple[Light, ...] = ()
    """Their light adds up."""


# Positions of named lights: at the lens; or 2.3 plane units from the origin, 31 degrees high.
NAMED_LIGHTS: dict[str, Vector] = {
    "flash": Camera().position,
    "top": (0.0, 2.0, 1.2),
    "left": (-2.0, 0.0, 1.2),
    "right": (2.0, 0.0, 1.2),
    "bottom": (0.0, -2.0, 1.2),
}


def exposing_intensity(position: Vector) -> float:
    """Radiant intensity of a point light under which a white diffuser at the origin has radiance 1.

    pi d^2 / cos, with distance d and cosine to +z. Mid-grey (18 %) is then code 118 of 255 in sRGB.
    """
    squared = sum(c * c for c in position)
    cosine = position[2] / math.sqrt(squared)
    return math.pi * squared / cosine


def scene_from_light(text: str) -> Scene:
    """A scene with the maps' own extent, from straight above, under one point light.

    Args:
        text: a key of NAMED_LIGHTS, or "x,y,z" or "x,y,z,intensity" in plane units;
            the default intensity is exposing_intensity.

    Raises:
        UsageError: neither a name nor three or four numbers; a light that is not above the plane.
    """
    if text in NAMED_LIGHTS:
        position = NAMED_LIGHTS[text]
        intensity = exposing_intensity(position)
    else:
        position, intensity = _parse_light(text)
    light = PointLight(position, (intensity, intensity, intensity))
    return Scene(film=None, surface=Surface(size=None), lights=(light,))


# Limits of lights given on the command line: plane units, radiant intensity.
_FARTHEST, _STRONGEST = 1e4, 1e9


def _parse_light(text: str) -> tuple[Vector, float]:
    remedy = nearest(text, NAMED_LIGHTS, "or x,y,z[,intensity] such as -1,1,2")
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4) or not all(math.isfinite(n) for n in numbers):
        raise UsageError.at("--light", f"'{text}' is not a light", remedy)
    x, y, z = numbers[:3]
    if z <= 0.0:
        raise UsageError.at(
            "--light", f"a light at z = {z:g} is not above the plane", "choose z > 0"
        )
    strength = numbers[3] if len(numbers) == 4 else 0.0
    if strength < 0.0:
        raise UsageError.at("--light", "the intensity is negative", "choose 0 or more")
    if max(abs(x), abs(y), z) > _FARTHEST or z < 1.0 / _FARTHEST or strength > _STRONGEST:
        raise UsageError.at(
            "--light",
            f"the light '{text}' is out of range",
            f"choose a place within {_FARTHEST:g} units, at least {1 / _FARTHEST:g} above "
            f"the plane, and an intensity up to {_STRONGEST:g}",
        )
    return (x, y, z), strength if len(numbers) == 4 else exposing_intensity((x, y, z))


def check_lights(lights: Sequence[Light]) -> None:
    """Refuse lights above BRIGHTEST.

    Raises:
        MatcapError: with the light's number and type.
    """
    for index, light in enumerate(lights):
        if max(_colour(light)) > BRIGHTEST:
            raise too_bright(lights, index)


def too_bright(lights: Sequence[Light], index: int | None = None) -> MatcapError:
    """The error that names a light: `index`, or the brightest where a picture has overflowed."""
    if index is None:
        index = max(range(len(lights)), key=lambda i: max(_colour(lights[i])))
    light = lights[index]
    return MatcapError.at(
        f"light {index + 1} ({light_name(type(light))})",
        f"{max(_colour(light)):.2g} is too bright for single precision",
        "give it less, or more distance, and let the film's exposure make up for it",
    )


def _colour(light: Light) -> Colour:
    if isinstance(light, PointLight):
        return light.intensity
    if isinstance(light, DirectionalLight):
        return light.irradiance
    if isinstance(light, EnvironmentLight) and light.file is not None:
        return (light.scale,) * 3
    return light.radiance
