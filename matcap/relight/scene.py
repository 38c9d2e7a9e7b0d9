"""What a scene is: film, camera, surface and lights, as plain values.

Lengths are plane units (half a photograph's long side), angles degrees, colours linear Rec.709.
x is right, y up, z towards the camera; the plane is z = 0. Files are read in scenefile.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from matcap.errors import UsageError

Vector = tuple[float, float, float]
Colour = tuple[float, float, float]

WHITE: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Film:
    """The picture."""

    width: int = 1024
    """Pixels."""
    height: int = 768
    """Pixels."""
    exposure: float = 0.0
    """Stops by which encoded pictures are brightened; radiance is left as it is."""
    transfer: Literal["srgb", "linear"] = "srgb"
    """How encoded pictures (PNG, GIF, MP4) store light."""

    @property
    def gain(self) -> float:
        """What radiance is multiplied by before it is encoded."""
        return 2.0**self.exposure


@dataclass(frozen=True)
class Camera:
    """Where the picture is taken from."""

    type: Literal["perspective", "orthographic"] = "perspective"
    """Either "perspective" or "orthographic"."""
    position: Vector = (0.0, 0.0, 1.0 / math.tan(math.radians(22.5)))
    """Its place."""
    target: Vector = (0.0, 0.0, 0.0)
    """The point in the middle of the picture."""
    fov: float = 45.0
    """Field of view across the long side, degrees; perspective only."""
    scale: float = 1.0
    """Half of what the long side shows; orthographic only."""
    up: Vector = (0.0, 1.0, 0.0)
    """The direction whose picture points upwards."""
    vignetting: float = 0.0
    """Share of light that a lens loses in the corners of a 4:3 picture, as an exponent:
    exp(-vignetting) is left there, and more towards the middle, with r squared. May be negative."""
    vignetting_quartic: float = 0.0
    """Likewise, with r to the fourth."""


@dataclass(frozen=True)
class Surface:
    """What the material lies on."""

    type: Literal["plane", "sphere", "cylinder", "mesh"] = "plane"
    """A plane or cylinder or sphere around the origin, or a mesh."""
    size: float | None = 2.0
    """Long side of a plane, diameter of a sphere or cylinder (whose height it also is), longest
    side of a mesh; None is the extent of the maps themselves."""
    file: Path | None = None
    """The mesh, a Wavefront OBJ."""
    repeat: float = 1.0
    """How many times smaller the material lies on the surface than it is."""
    displacement: float = 1.0
    """Factor on the height where it moves the surface (parallax, shadows, visibility,
    interreflection). Normals are the maps' own whatever it says: 0 keeps the shading of relief and
    drops its geometry."""


@dataclass(frozen=True)
class PointLight:
    """Light from one point, falling off with distance squared."""

    position: Vector
    """Its place."""
    intensity: Colour = WHITE
    """Radiant intensity."""


@dataclass(frozen=True)
class DirectionalLight:
    """Light from infinitely far."""

    direction: Vector
    """Towards the light."""
    irradiance: Colour = WHITE
    """What a surface facing the light receives."""


@dataclass(frozen=True)
class SphereLight:
    """A glowing sphere."""

    position: Vector
    """Its middle."""
    radius: float
    """Of the sphere."""
    radiance: Colour = WHITE
    """The same in all directions."""


@dataclass(frozen=True)
class RectangleLight:
    """A rectangle that glows on the side its normal points to."""

    position: Vector
    """Its middle."""
    normal: Vector
    """Where it shines."""
    up: Vector = (0.0, 1.0, 0.0)
    """Direction of its second side; made perpendicular to the normal."""
    size: tuple[float, float] = (1.0, 1.0)
    """Its sides, across and along `up`."""
    radiance: Colour = WHITE
    """The same in all directions."""


@dataclass(frozen=True)
class EnvironmentLight:
    """Light from everywhere: a picture of the surroundings, or the same radiance all around.

    The picture is latitude by longitude, its top is +y, its middle is +z, which the plane faces,
    and its right half is towards -x, as somebody standing inside sees it.
    """

    file: Path | None = None
    """EXR or HDR; None for a constant."""
    scale: float = 1.0
    """Factor on the picture."""
    rotation: float = 0.0
    """Degrees by which the surroundings are turned about +y, anticlockwise from above."""
    radiance: Colour = WHITE
    """Of a constant environment."""


Light = PointLight | DirectionalLight | SphereLight | RectangleLight | EnvironmentLight


@dataclass(frozen=True)
class Scene:
    """Film, camera, surface and lights."""

    film: Film | None = field(default_factory=Film)
    """None takes one pixel a texel where the source is a map set, else Film()."""
    camera: Camera | None = None
    """None is the photograph's: straight above, 45 degrees across the long side, as far away as
    frames the surface's long side."""
    surface: Surface = field(default_factory=Surface)
    """What the material lies on."""
    lights: tuple[Light, ...] = ()
    """At least none; their light adds up."""


# Places of the named lights: at the lens, and 2.3 units from the middle, 31 degrees above it.
NAMED_LIGHTS: dict[str, Vector] = {
    "flash": Camera().position,
    "top": (0.0, 2.0, 1.2),
    "left": (-2.0, 0.0, 1.2),
}


def exposing_intensity(position: Vector) -> float:
    """Radiant intensity with which a point light shows white as white.

    A perfect white diffuser at the origin then has radiance 1, and one of mid-grey (18 %) 0.18,
    which is code value 118 of 255 in sRGB: well exposed.
    """
    squared = sum(c * c for c in position)
    cosine = position[2] / math.sqrt(squared)
    return math.pi * squared / cosine


def scene_from_light(text: str, *, film: Film | None = None) -> Scene:
    """A scene of the maps themselves, seen as photographed, under one point light.

    Args:
        text: a named light (flash, top, left) or "x,y,z" or "x,y,z,intensity" in plane units;
            without an intensity the light is as strong as exposing_intensity says.
        film: the picture; by default one pixel a texel.

    Raises:
        UsageError: neither a name nor three or four numbers; a light that is not above the plane.
    """
    if text in NAMED_LIGHTS:
        position = NAMED_LIGHTS[text]
        intensity = exposing_intensity(position)
    else:
        position, intensity = _parse_light(text)
    light = PointLight(position, (intensity, intensity, intensity))
    return Scene(film=film, surface=Surface(size=None), lights=(light,))


# Of lights given on the command line: plane units, radiant intensity.
_FARTHEST, _STRONGEST = 1e4, 1e9


def _parse_light(text: str) -> tuple[Vector, float]:
    remedy = f"give {', '.join(NAMED_LIGHTS)} or x,y,z[,intensity] such as -1,1,2"
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4) or not all(math.isfinite(n) for n in numbers):
        raise UsageError(f"'{text}' is not a light", where="--light", remedy=remedy)
    x, y, z = numbers[:3]
    if z <= 0.0:
        raise UsageError(
            f"a light at z = {z:g} is not above the plane", where="--light", remedy="choose z > 0"
        )
    strength = numbers[3] if len(numbers) == 4 else 0.0
    if strength < 0.0:
        raise UsageError("the intensity is negative", where="--light", remedy="choose 0 or more")
    if max(abs(x), abs(y), z) > _FARTHEST or z < 1.0 / _FARTHEST or strength > _STRONGEST:
        raise UsageError(
            f"the light '{text}' is out of range",
            where="--light",
            remedy=f"choose a place within {_FARTHEST:g} units, at least {1 / _FARTHEST:g} above "
            f"the plane, and an intensity up to {_STRONGEST:g}",
        )
    return (x, y, z), strength if len(numbers) == 4 else exposing_intensity((x, y, z))
