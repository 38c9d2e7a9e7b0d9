"""A simulated flash photograph of isotropic bumps, with everything that is known of it."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.capture.rectified import Observation, PhotographLight
from matcap.files.color import srgb_decode, srgb_encode
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import render_flash
from matcap.flash.rectify import Plane, plane_of

SETUP = FlashSetup(fov=65.0, offset=(0.08, 0.04, 0.0), intensity=(6.0,) * 3)


@dataclass(frozen=True)
class Photographed:
    """Picture (3, H, W), truth, and where its texels lie."""

    linear: torch.Tensor
    maps: MapSet
    uniform: CoarseFit
    points: torch.Tensor

    @property
    def light(self) -> PhotographLight:
        """At every texel."""
        return PhotographLight.of(self.uniform, self.points)


def photographed(
    slope: float, contrast: float, *, width: int = 512, height: int = 384, seed: int = 0
) -> Photographed:
    """Bumps of a root-mean-square slope under an albedo of a log contrast, matte."""
    rng = np.random.default_rng(seed)

    def clouds(deviation: float) -> np.ndarray:
        noise = rng.standard_normal((height, width)).astype(np.float32)
        return cv2.GaussianBlur(noise, (0, 0), deviation)

    bumps = clouds(3.0)
    down, across = np.gradient(bumps)
    bumps *= slope / np.sqrt((down**2 + across**2).mean())
    tone = clouds(2.0)
    tone *= contrast / max(float(tone.std()), 1e-9)
    one = torch.ones(1, height, width)
    uniform = CoarseFit((0.3, 0.25, 0.2), 0.04, 0.7, SETUP, residual=0.0)
    maps = MapSet(
        torch.tensor(uniform.diffuse)[:, None, None] * torch.from_numpy(np.exp(tone)),
        0.04 * one,
        0.7 * one,
        torch.from_numpy(bumps)[None] * (2.0 / width),
        2.0 / width,
    )
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    return Photographed(render_flash(maps, SETUP, points), maps, uniform, points)


def even(shot: Photographed, albedo: float, roughness: float) -> Photographed:
    """The same relief of an even dielectric."""
    one = torch.ones_like(shot.maps.height)
    grey = albedo * one.expand(3, -1, -1)
    maps = replace(shot.maps, diffuse=grey, specular=0.04 * one, roughness=roughness * one)
    return replace(shot, maps=maps, linear=render_flash(maps, shot.uniform.setup, shot.points))


def whole_plane(linear: torch.Tensor) -> Plane:
    """A picture of which every texel counts."""
    return plane_of(linear, torch.ones(linear.shape[-2:], dtype=torch.bool))


def in_8_bits(albedo: float, intensity: float) -> tuple[Photographed, Observation]:
    """Glossy bumps photographed into 8-bit sRGB codes, clipped at white."""
    setup = replace(SETUP, intensity=(intensity,) * 3)
    uniform = CoarseFit((albedo,) * 3, 0.045, 0.35, setup, residual=0.0)
    shot = replace(photographed(0.1, 0.0), uniform=uniform)
    even = torch.ones_like(shot.maps.diffuse)
    maps = replace(shot.maps, diffuse=albedo * even, roughness=0.35 * even[:1])
    light = render_flash(maps, setup, shot.points).clamp(0.0, 1.0).numpy()
    codes = np.rint(255.0 * srgb_encode(light)) / 255.0
    linear = torch.from_numpy(srgb_decode(codes).astype(np.float32))
    plane = replace(plane_of(linear, (linear < 1.0).all(0)), developed=True)
    return replace(shot, maps=maps, linear=linear), Observation.of(plane, uniform)
