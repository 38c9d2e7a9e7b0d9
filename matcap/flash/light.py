"""The flash's light on a surface: the one differentiable renderer of flash photographs.

A point light, inverse-square falloff, the Cook-Torrance reflectance (brdf/cook_torrance.py), no
shadows: the flash sits beside the lens, so what it cannot reach the camera hardly sees. Radiance is
linear in irradiance E = I (n.l) / d^2, and in its two parts:

    L = (diffuse / pi + D G F / (4 (n.l)(n.v))) E

What stays the same is worked out once: directions and power of a light that stands still
(`FlashLight`), then what arrives at a relief that does (`Incidence`). Any leading batch dimensions.

Read next: render.py, pictures of whole map sets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.brdf.cook_torrance import Angles, dot, normalize, specular_lobe
from matcap.flash.geometry import FlashSetup, camera_in_plane, project

# Corner of a 4:3 picture: its squared distance from the middle, where vignetting is stated.
CORNER_SQUARED = 1.25**2


@dataclass(frozen=True)
class Incidence:
    """Light that arrives at a relief, and is seen."""

    angles: Angles
    """Between normal, light and view."""
    irradiance: Tensor
    """(..., 1 or 3, H, W) E; 0 where light or view is below the surface, unless the angles are
    quick."""

    def diffuse(self, albedo: Tensor) -> Tensor:
        """Radiance (..., 3, H, W) of diffuse albedo (..., 3, H, W)."""
        return albedo / math.pi * self.irradiance

    def specular(self, specular: Tensor, roughness: Tensor) -> Tensor:
        """Radiance (..., 1 or 3, H, W) mirrored by F0 (..., 1 or 3, H, W) and roughness."""
        return specular_lobe(specular, roughness, self.angles) * self.irradiance

    def radiance(self, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
        """Radiance (..., 3, H, W) of both parts."""
        return self.diffuse(diffuse) + self.specular(specular, roughness)


@dataclass(frozen=True)
class FlashLight:
    """A point light and a camera, from places of the plane."""

    to_light: Tensor
    to_view: Tensor
    """(..., 3, H, W) unit vectors."""
    power: Tensor
    """(..., 1 or 3, H, W) irradiance of a surface that faces the light."""

    @staticmethod
    def between(points: Tensor, camera: Tensor, light: Tensor, intensity: Tensor) -> FlashLight:
        """Of a light and a camera anywhere.

        Args:
            points: (..., 3, H, W) places that are lit, in plane units.
            camera: (3,) or (..., 3, 1, 1) place of the camera.
            light: likewise, of the light.
            intensity: (3,), (..., 1 or 3, 1, 1) or (..., 1 or 3, H, W): radiant intensity.
        """
        camera, light, intensity = (_column(v) for v in (camera, light, intensity))
        offset = light - points
        squared_distance = dot(offset, offset)
        return FlashLight(
            offset * squared_distance.rsqrt(),
            normalize(camera - points),
            intensity / squared_distance,
        )

    @staticmethod
    def of(setup: FlashSetup, points: Tensor) -> FlashLight:
        """Of a photograph, its lens's vignetting included, at plane points (..., 3, H, W)."""
        camera, light = (v.to(points) for v in camera_in_plane(setup))
        intensity = torch.tensor(setup.intensity).to(points)[:, None, None]
        return FlashLight.between(points, camera, light, intensity * vignette(points, setup))

    def cut(self, rows: slice, columns: slice) -> FlashLight:
        """The light at some of the places."""
        return FlashLight(
            self.to_light[..., rows, columns],
            self.to_view[..., rows, columns],
            self.power[..., rows, columns],
        )

    def onto(self, normal: Tensor, *, exact: bool = False) -> Incidence:
        """What arrives at a relief of unit normals (..., 3, H, W).

        Args:
            normal: of the relief.
            exact: highlights of any width, and dark below the horizon; else in single precision
                and never quite dark, for logarithms and gradients (Angles.quick).
        """
        angles = (Angles.exact if exact else Angles.quick)(normal, self.to_light, self.to_view)
        return Incidence(angles, angles.lit(self.power * angles.n_dot_l))


def vignette(points: Tensor, setup: FlashSetup) -> Tensor:
    """(..., 1, H, W) share of light that reaches the sensor from plane points (..., 3, H, W)."""
    image = project(points.movedim(-3, 0), setup)
    return log_vignette(image, setup.vignetting, setup.vignetting_quartic).exp().unsqueeze(-3)


def log_vignette(image: Tensor, vignetting: float | Tensor, quartic: float | Tensor) -> Tensor:
    """(...) logarithm of that share at image coordinates (2, ...); FlashSetup has the numbers."""
    squared = image.square().sum(0) / CORNER_SQUARED
    return -squared * (vignetting + quartic * squared)


def _column(vector: Tensor) -> Tensor:
    return vector[:, None, None] if vector.ndim == 1 else vector
