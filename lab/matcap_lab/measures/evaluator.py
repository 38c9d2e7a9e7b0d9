"""The evaluator: true samples of a material, relit under lights of its own, to compare maps with.

Estimated maps are compared with samples of the material other than the photographed one, so that
pixel alignment gives no advantage, and under lights other than the photograph's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.heights import resized_height
from matcap.brdf.maps import MapSet
from matcap.capture.verdict.causes import FAR, NEAR
from matcap.errors import MatcapError
from matcap.files.color import LUMINANCE
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import shade
from matcap_lab.measures.nsd import StyleRatio
from matcap_lab.measures.style import Style, srgb_encode_tensor
from matcap_lab.simulate.photograph import PhoneCamera, in_strips
from matcap_lab.simulate.specimen import Specimen

Intensity = tuple[float, float, float]  # of the flash that goes with maps


@dataclass(frozen=True)
class EvaluationSettings:
    """Sizes, lights and true samples of the comparison."""

    detail: int = 512
    """Texels along the photograph's long side, at the resolution compared."""
    size: int = 256
    """Side of the compared central square, texels; at least 128."""
    camera: PhoneCamera = field(default_factory=PhoneCamera)
    """Camera of the photograph; its blur is applied to true samples."""
    truths: int = 3
    """Number of true samples, at least 2."""
    finer: int = 4
    """True samples are shaded at this many texels a pixel, along each side, and averaged."""
    every: int = 2
    """Step through the bench's ten lights: 2 uses every second one."""

    @property
    def width(self) -> float:
        """Side of the compared square, plane units."""
        return self.size * 2.0 / self.detail


class Evaluator:
    """True samples of a material, relit, with their texture statistics by one or more styles."""

    def __init__(
        self,
        subject: Specimen,
        flash: FlashSetup,
        settings: EvaluationSettings,
        styles: Mapping[str, Style],
    ) -> None:
        """Relight true samples, none of them the photographed one.

        `flash` is the true setup of the photograph; styles are texture statistics by name.
        """
        whole = bench_scene(flash)
        self.scene = BenchScene(whole.distance, whole.lights[:: settings.every])
        self.flash, self.settings, self.styles = flash, settings, dict(styles)
        finest = settings.detail * settings.finer
        texel, pixels = 2.0 / finest, settings.size * settings.finer
        seeds = range(subject.seed + 1, subject.seed + 1 + settings.truths)
        self.truths = [subject.pieces(seed)(pixels, pixels, texel) for seed in seeds]
        self._blur = settings.camera.blur * finest / settings.camera.width
        self._distances: dict[tuple[str, BenchScene], StyleRatio] = {}

    @cached_property
    def pictures(self) -> list[Tensor]:
        """(L, 3, H, W) pictures of each true sample under the evaluator's lights."""
        return self.relit_truths(self.scene)

    @property
    def own_scene(self) -> BenchScene:
        """Scene lit by the photograph's own flash alone."""
        x, y, z = self.flash.offset
        light = BenchLight((x, y, z + self.flash.distance), 1.0)
        return BenchScene(self.flash.distance, (light,))

    def relit_truths(self, scene: BenchScene) -> list[Tensor]:
        """(L, 3, H, W) pictures of each true sample under a scene's lights."""
        size, intensity = (self.settings.size,) * 2, self.flash.intensity
        return [
            relight_all(maps, intensity, scene, size=size, blur=self._blur) for maps in self.truths
        ]

    def relit(self, maps: MapSet, intensity: Intensity, scene: BenchScene | None = None) -> Tensor:
        """(L, 3, H, W) pictures of maps; `intensity` is the flash's, estimated with them."""
        floats = maps.map(lambda m: m.detach().float())
        return relight_all(floats, intensity, scene or self.scene, size=(self.settings.size,) * 2)

    def style_ratio(
        self, pictures: Tensor, style: str | None = None, scene: BenchScene | None = None
    ) -> float:
        """Style distance of pictures (L, 3, H, W) relit in a scene, over that of true samples.

        Args:
            pictures: from `relit`.
            style: name of the statistics; the first by default.
            scene: camera and lights; the evaluator's by default.
        """
        name, scene = style or next(iter(self.styles)), scene or self.scene
        if (name, scene) not in self._distances:
            truths = self.pictures if scene == self.scene else self.relit_truths(scene)
            self._distances[name, scene] = StyleRatio(self.styles[name], truths)
        return self._distances[name, scene].of(pictures)

    def style_ratio_of(self, maps: MapSet, intensity: Intensity) -> float:
        """Style ratio of the maps' central square; `intensity` as of `relit`."""
        return self.style_ratio(self.relit(self.middle(maps), intensity))

    def middle(self, maps: MapSet) -> MapSet:
        """Crop of maps to the central square that is compared.

        Raises:
            MatcapError: the maps are smaller.
        """
        side = self.side(maps.texel_size)
        width, height = maps.size
        if min(width, height) < side:
            raise MatcapError(
                f"the capture gives {width} x {height} texels, {side} x {side} are compared",
                remedy="compare smaller pictures",
            )
        return maps.crop((width - side) // 2, (height - side) // 2, side, side)

    def side(self, texel_size: float) -> int:
        """Side of the compared square in texels of a size (plane units)."""
        return round(self.settings.width / texel_size)


# Materials under lights they were not photographed with, as the photograph's camera sees them.
#
# Highlight contrast under mirrored lights, and highlight residue in maps, are measured here too.

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
    """A point light: its place above the plane, and its strength, that of the flash being 1."""

    place: tuple[float, float, float]
    strength: float


@dataclass(frozen=True)
class BenchScene:
    """Height of the camera above the plane's middle, plane units; lights, used one at a time."""

    distance: float
    lights: tuple[BenchLight, ...]


def spherical(distance: float, polar: float, azimuth: float) -> tuple[float, float, float]:
    """Point at a distance from the origin, at angles from the normal and from x, radians."""
    aside = distance * math.sin(polar)
    return aside * math.cos(azimuth), aside * math.sin(azimuth), distance * math.cos(polar)


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
        strength = (distance / flash.distance) ** 2 / math.cos(polar)
        lights.append(BenchLight(spherical(distance, polar, index * _GOLDEN_ANGLE), strength))
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


def relight_all(
    maps: MapSet,
    intensity: tuple[float, float, float],
    scene: BenchScene,
    *,
    size: tuple[int, int] | None = None,
    blur: float = 0.0,
) -> Tensor:
    """(L, 3, H, W) float32 sRGB pictures in [0, 1] of maps in the middle of the plane, by light.

    A light's strength is relative to the flash estimated with the maps, so the scale between
    flash and albedo, ambiguous in one photograph, cancels. Pictures are exposed like the
    photograph, and clipped at 1.

    Args:
        maps: one map set without batch dimensions.
        intensity: radiant intensity of the flash estimated with the maps.
        scene: camera and lights.
        size: (H, W) of the picture, the maps' by default: radiance of finer maps is averaged over
            its pixels as a sensor does, that of coarser ones interpolated.
        blur: standard deviation of the lens's blur before resampling, in texels.
    """
    width, height = maps.size
    camera = torch.tensor([0.0, 0.0, scene.distance])
    # plane_points counts in half widths of its grid.
    half_width = maps.texel_size * width / 2.0

    def shaded(light: BenchLight, strip: MapSet, first: int) -> Tensor:
        grid = half_width * plane_points(
            0, first, *strip.size, (width, height), dtype=torch.float32
        )
        place, power = torch.tensor(light.place), torch.tensor(intensity) * light.strength
        return shade(strip.map(lambda m: m.float()), grid, camera, place, power)

    pictures = []
    for light in scene.lights:
        linear = in_strips(maps, partial(shaded, light), _ROWS)
        if blur:
            linear = torch.from_numpy(
                cv2.GaussianBlur(linear.permute(1, 2, 0).contiguous().numpy(), (0, 0), blur)
            ).permute(2, 0, 1)
        seen = _resized(linear, size or (height, width))
        pictures.append(srgb_encode_tensor(seen.clamp(0.0, 1.0)))
    return torch.stack(pictures)


def _resized(linear: Tensor, size: tuple[int, int]) -> Tensor:
    """A picture (3, H, W) resized: area means for larger pixels, interpolated for smaller."""
    height, width = linear.shape[-2:]
    if size == (height, width):
        return linear
    if size[0] <= height and size[1] <= width:
        return F.interpolate(linear[None], size, mode="area")[0]
    return F.interpolate(linear[None], size, mode="bilinear", align_corners=False)[0]


_OCTAVES, _SECTORS = 5, 8
_LEAST = 0.01  # of the strongest octave's energy
_RINGS = 0.84  # largest radius, over the shorter half side: rings lie in the map


def mirror_point(scene: BenchScene, place: tuple[float, float, float]) -> tuple[float, float]:
    """Mirror point in the plane of a light at a place, for the scene's camera; plane units."""
    share = scene.distance / (scene.distance + place[2])
    return share * place[0], share * place[1]


def highlight_contrast(maps: MapSet, scene: BenchScene) -> float:
    """Mean of L / L_matte near the mirror point over its mean far from it; 1 is a matte surface.

    L_matte is a uniform matte plane's radiance. Geometric mean over the scene's lights. The maps
    lie in the middle of the plane and hold every light's mirror point.
    """
    width, height = maps.size
    half = maps.texel_size * width / 2.0
    points = half * plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    camera, one = torch.tensor([0.0, 0.0, scene.distance]), torch.ones(1, height, width)
    matte = MapSet(0.2 * one.expand(3, -1, -1), 1e-6 * one, one, 0.0 * one, maps.texel_size)
    floats = maps.map(lambda m: m.detach().float())
    logs = []
    for light in scene.lights:
        place, power = torch.tensor(light.place), torch.full((3,), light.strength)
        lit, even = (shade(each, points, camera, place, power).mean(0) for each in (floats, matte))
        x, y = mirror_point(scene, light.place)
        distance = torch.hypot(points[0] - x, points[1] - y)
        ratio = lit / even
        logs.append((ratio[distance < NEAR].mean() / ratio[distance > FAR].mean()).log())
    return float(torch.stack(logs).mean().exp())


def imprint(plane: Tensor, towards: tuple[float, float]) -> float:
    """Radial anisotropy of a map about the flash's mirror point, in [-1, 1]; 0 if isotropic.

    (E_r - E_t) / (E_r + E_t), E the mean squares of radial and tangential gradients of a band of
    one octave over a disc around the point; the octave where it is largest in magnitude.

    Args:
        plane: (H, W) a map, or its logarithm.
        towards: x, y of the point from the middle, in half widths.
    """
    values = plane.detach().numpy().astype(np.float32)
    height, width = values.shape
    v, u = np.mgrid[:height, :width] + 0.5
    x, y = u - (towards[0] + 1.0) * width / 2.0, v - (height - towards[1] * width) / 2.0
    distance = np.maximum(np.hypot(x, y), 1.0)
    whole = distance < _RINGS * 0.5 * min(height, width)
    sector = (np.arctan2(y, x) / (2.0 * np.pi) % 1.0 * _SECTORS).astype(int) % _SECTORS
    energies = []
    for octave in range(_OCTAVES):
        band = _blurred(values, 2.0**octave) - _blurred(values, 2.0 ** (octave + 1))
        down, across = np.gradient(band)
        radial = np.square((across * x + down * y) / distance)
        around = np.square((across * -y + down * x) / distance)
        sums = [
            (radial[whole & (sector == k)].mean(), around[whole & (sector == k)].mean())
            for k in range(_SECTORS)
        ]
        energies.append(np.array(sums).mean(0))
    # The ratio of an octave with hardly any gradient energy is noise.
    least = max(_LEAST * max(float(each.sum()) for each in energies), 1e-12)
    ratios = [float((a - b) / (a + b)) for a, b in energies if a + b > least]
    return max(ratios, key=abs, default=0.0)


def _blurred(plane: NDArray[np.float32], deviation: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(plane, (0, 0), deviation), np.float32)


# Summary statistics of maps, and their errors against true maps of the same texels.

_STEEP = 3.0  # degrees: where normals are compared
_DARK = 1e-3  # of albedo


def map_statistics(maps: MapSet) -> dict[str, float]:
    """Mean angle of the normal from the plane's, degrees; contrast of albedo; mean roughness.

    The contrast is the standard deviation of the logarithm of diffuse albedo's luminance.
    """
    luminance = torch.tensor(LUMINANCE)[:, None, None] * maps.diffuse.float()
    return {
        "tilt": float(maps.normal[2].clamp(-1.0, 1.0).acos().rad2deg().mean()),
        "albedo": float((luminance.sum(0) + _DARK).log().std()),
        "roughness": float(maps.roughness.mean()),
    }


def map_errors(estimate: MapSet, true: MapSet, where: Tensor | None = None) -> dict[str, float]:
    """Errors over all texels, or over those of `where`, (H, W) bool, by name.

    normals: mean angle between normals, degrees, where the true tilt exceeds 3; flat: that of a
    flat normal map, the mean true tilt there; albedo: mean absolute difference of log albedo, after
    subtracting the median difference; roughness: mean absolute difference.
    """
    here = torch.ones(estimate.size[::-1], dtype=torch.bool) if where is None else where
    off = (true.normal.float() * estimate.normal).sum(0).clamp(-1.0, 1.0).acos().rad2deg()
    lean = true.normal[2].clamp(-1.0, 1.0).acos().rad2deg()
    steep = (lean > _STEEP) & here
    log = (estimate.diffuse.mean(0) + _DARK).log() - (true.diffuse.mean(0) + _DARK).log()
    return {
        "normals": float(off[steep].mean()),  # NaN of none
        "flat": float(lean[steep].mean()),
        "albedo": float((log - log[here].median())[here].abs().mean()),
        "roughness": float((estimate.roughness - true.roughness)[0][here].abs().mean()),
    }


def compared_numbers(estimate: MapSet, truths: Sequence[MapSet]) -> dict[str, float]:
    """map_statistics() of maps, and their means over true samples in texels of the same size."""
    shrunk = [map_statistics(shrunk_to(maps, estimate.texel_size)) for maps in truths]
    columns = {}
    for name, value in map_statistics(estimate).items():
        columns[name] = value
        columns[f"true {name}"] = sum(one[name] for one in shrunk) / len(shrunk)
    return columns


def shrunk_to(maps: MapSet, texel_size: float) -> MapSet:
    """Means over texels of a size, no finer than the maps', and heights with their mean slopes."""
    width, height = maps.size
    share = min(1.0, maps.texel_size / texel_size)
    size = (round(height * share), round(width * share))
    stacked: Tensor = F.interpolate(maps.stacked()[None].float(), size, mode="area")[0]
    stacked[-1] = torch.from_numpy(resized_height(maps.height[0].float().numpy(), size[::-1]))
    return MapSet.from_stacked(stacked, maps.texel_size * width / size[1])
