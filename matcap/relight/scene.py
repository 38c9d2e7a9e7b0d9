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
    """The picture.

    Attributes:
        width: pixels.
        height: pixels.
        exposure: stops by which encoded pictures are brightened; radiance is left as it is.
        transfer: how encoded pictures (PNG, GIF, MP4) store light.
    """

    width: int = 1024
    height: int = 768
    exposure: float = 0.0
    transfer: Literal["srgb", "linear"] = "srgb"

    @property
    def gain(self) -> float:
        """What radiance is multiplied by before it is encoded."""
        return 2.0**self.exposure


@dataclass(frozen=True)
class Camera:
    """Where the picture is taken from.

    Attributes:
        type: "perspective" or "orthographic".
        position: its place.
        target: the point in the middle of the picture.
        fov: field of view across the long side, degrees; perspective only.
        scale: half of what the long side shows; orthographic only.
        up: the direction whose picture points upwards.
        vignetting: share of light that a lens loses in the corners of a 4:3 picture, as an
            exponent: exp(-vignetting) is left there, and more towards the middle, with r squared.
            May be negative.
        vignetting_quartic: likewise, with r to the fourth.
    """

    type: Literal["perspective", "orthographic"] = "perspective"
    position: Vector = (0.0, 0.0, 1.0 / math.tan(math.radians(22.5)))
    target: Vector = (0.0, 0.0, 0.0)
    fov: float = 45.0
    scale: float = 1.0
    up: Vector = (0.0, 1.0, 0.0)
    vignetting: float = 0.0
    vignetting_quartic: float = 0.0


@dataclass(frozen=True)
class Surface:
    """What the material lies on.

    Attributes:
        type: a plane or cylinder or sphere around the origin, or a mesh.
        size: long side of a plane, diameter of a sphere or cylinder (whose height it also is),
            longest side of a mesh; None is the extent of the maps themselves.
        file: the mesh, a Wavefront OBJ.
        repeat: how many times smaller the material lies on the surface than it is.
        displacement: factor on the height where it moves the surface (parallax, shadows,
            visibility, interreflection). Normals are the maps' own whatever it says: 0 keeps the
            shading of relief and drops its geometry.
    """

    type: Literal["plane", "sphere", "cylinder", "mesh"] = "plane"
    size: float | None = 2.0
    file: Path | None = None
    repeat: float = 1.0
    displacement: float = 1.0


@dataclass(frozen=True)
class PointLight:
    """Light from one point, falling off with distance squared.

    Attributes:
        position: its place.
        intensity: radiant intensity.
    """

    position: Vector
    intensity: Colour = WHITE


@dataclass(frozen=True)
class DirectionalLight:
    """Light from infinitely far.

    Attributes:
        direction: towards the light.
        irradiance: what a surface facing the light receives.
    """

    direction: Vector
    irradiance: Colour = WHITE


@dataclass(frozen=True)
class SphereLight:
    """A glowing sphere.

    Attributes:
        position: its middle.
        radius: of the sphere.
        radiance: the same in all directions.
    """

    position: Vector
    radius: float
    radiance: Colour = WHITE


@dataclass(frozen=True)
class RectangleLight:
    """A rectangle that glows on the side its normal points to.

    Attributes:
        position: its middle.
        normal: where it shines.
        up: direction of its second side; made perpendicular to the normal.
        size: its sides, across and along `up`.
        radiance: the same in all directions.
    """

    position: Vector
    normal: Vector
    up: Vector = (0.0, 1.0, 0.0)
    size: tuple[float, float] = (1.0, 1.0)
    radiance: Colour = WHITE


@dataclass(frozen=True)
class EnvironmentLight:
    """Light from everywhere: a picture of the surroundings, or the same radiance all around.

    The picture is latitude by longitude, its top is +y, its middle is +z, which the plane faces,
    and its right half is towards -x, as somebody standing inside sees it.

    Attributes:
        file: EXR or HDR; None for a constant.
        scale: factor on the picture.
        rotation: degrees by which the surroundings are turned about +y, anticlockwise from above.
        radiance: of a constant environment.
    """

    file: Path | None = None
    scale: float = 1.0
    rotation: float = 0.0
    radiance: Colour = WHITE


Light = PointLight | DirectionalLight | SphereLight | RectangleLight | EnvironmentLight


@dataclass(frozen=True)
class Scene:
    """Film, camera, surface and lights.

    Attributes:
        film: None takes one pixel a texel where the source is a map set, else Film().
        camera: None is the photograph's: straight above, 45 degrees across the long side, as far
            away as frames the surface's long side.
        surface: what the material lies on.
        lights: at least none; their light adds up.
    """

    film: Film | None = field(default_factory=Film)
    camera: Camera | None = None
    surface: Surface = field(default_factory=Surface)
    lights: tuple[Light, ...] = ()


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
