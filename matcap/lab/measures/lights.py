"""Materials under lights they were not photographed with, as the photograph's camera sees them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.files.srgb import srgb_encode_tensor
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.render import shade
from matcap.lab.simulate.photograph import in_strips

LIGHTS = 10
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
# Degrees from the plane's normal: far from the photograph's flash, and not yet grazing.
_NEAREST, _FURTHEST = 25.0, 65.0
_DISTANCES = (1.5, 3.0)  # plane units
_MIRRORED = 5
_STRAIGHT, _ASIDE = 5.0, 20.0  # degrees
_ROWS = 128  # shaded at a time


@dataclass(frozen=True)
class BenchLight:
    """A point light above the plane.

    Attributes:
        place: plane frame, plane units.
        strength: radiant intensity as a multiple of the flash's.
    """

    place: tuple[float, float, float]
    strength: float


@dataclass(frozen=True)
class BenchScene:
    """Positions of camera and lights.

    Attributes:
        distance: height of the camera above the plane's middle, plane units.
        lights: point lights, used one at a time.
    """

    distance: float
    lights: tuple[BenchLight, ...]


def bench_scene(flash: FlashSetup) -> BenchScene:
    """The photograph's camera and the bench's fixed lights, spread over the hemisphere in a spiral.

    Each light gives the plane's middle the irradiance of a flash at the camera, so that one
    exposure fits all: strength (d / d_camera)^2 / cos theta.
    """
    lights = []
    for index in range(LIGHTS):
        share = (index + 0.5) / LIGHTS
        polar = math.radians(_NEAREST + (_FURTHEST - _NEAREST) * share)
        # Near and far alternate, so that height and distance are uncorrelated.
        distance = _DISTANCES[0] + (_DISTANCES[1] - _DISTANCES[0]) * ((3 * index) % LIGHTS) / 9.0
        around = index * _GOLDEN_ANGLE
        place = (
            distance * math.sin(polar) * math.cos(around),
            distance * math.sin(polar) * math.sin(around),
            distance * math.cos(polar),
        )
        strength = (distance / flash.distance) ** 2 / math.cos(polar)
        lights.append(BenchLight(place, strength))
    return BenchScene(flash.distance, tuple(lights))


def mirrored_scene(flash: FlashSetup) -> BenchScene:
    """The photograph's camera and five lights whose mirror images lie in the picture.

    At 5 to 20 degrees from the plane's normal and at the camera's height, with the strengths of
    `bench_scene`. Only such lights show the specular lobe's peak.
    """
    lights = []
    for index in range(_MIRRORED):
        share = index / (_MIRRORED - 1)
        polar = math.radians(_STRAIGHT + (_ASIDE - _STRAIGHT) * share)
        around, aside = index * _GOLDEN_ANGLE, flash.distance * math.tan(polar)
        place = (aside * math.cos(around), aside * math.sin(around), flash.distance)
        lights.append(BenchLight(place, math.cos(polar) ** -3))
    return BenchScene(flash.distance, tuple(lights))


def relight(
    maps: MapSet,
    intensity: tuple[float, float, float],
    scene: BenchScene,
    light: BenchLight,
    *,
    size: tuple[int, int] | None = None,
    blur: float = 0.0,
) -> Tensor:
    """(3, H, W) float32 sRGB picture in [0, 1] of maps in the middle of the plane.

    The light's strength is relative to the flash estimated with the maps, so the scale between
    flash and albedo, ambiguous in one photograph, cancels. The picture is exposed like the
    photograph, and clipped at 1.

    Args:
        maps: one map set without batch dimensions.
        intensity: radiant intensity of the flash estimated with the maps.
        scene: the camera.
        light: the light.
        size: (H, W) of the picture, the maps' by default: radiance of finer maps is averaged over
            its pixels as a sensor does, that of coarser ones interpolated.
        blur: standard deviation of the lens's blur before resampling, in texels.
    """
    width, height = maps.size
    camera = torch.tensor([0.0, 0.0, scene.distance])
    place = torch.tensor(light.place)
    power = torch.tensor(intensity) * light.strength
    # plane_points counts in half widths of its grid.
    half_width = maps.texel_size * width / 2.0

    def shaded(strip: MapSet, first: int) -> Tensor:
        grid = plane_points(0, first, *strip.size, (width, height), dtype=torch.float32)
        return shade(strip.map(lambda m: m.float()), half_width * grid, camera, place, power)

    linear = in_strips(maps, shaded, _ROWS)
    if blur:
        linear = torch.from_numpy(
            cv2.GaussianBlur(linear.permute(1, 2, 0).contiguous().numpy(), (0, 0), blur)
        ).permute(2, 0, 1)
    return srgb_encode_tensor(_resized(linear, size or (height, width)).clamp(0.0, 1.0))


def relight_all(
    maps: MapSet,
    intensity: tuple[float, float, float],
    scene: BenchScene,
    *,
    size: tuple[int, int] | None = None,
    blur: float = 0.0,
) -> Tensor:
    """(L, 3, H, W) pictures under each light of a scene."""
    pictures = [
        relight(maps, intensity, scene, light, size=size, blur=blur) for light in scene.lights
    ]
    return torch.stack(pictures)


def _resized(linear: Tensor, size: tuple[int, int]) -> Tensor:
    """A picture (3, H, W) resized: area means for larger pixels, interpolated for smaller."""
    height, width = linear.shape[-2:]
    if size == (height, width):
        return linear
    if size[0] <= height and size[1] <= width:
        return F.interpolate(linear[None], size, mode="area")[0]
    return F.interpolate(linear[None], size, mode="bilinear", align_corners=False)[0]
