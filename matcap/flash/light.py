"""The flash's light on maps: log radiance with its Jacobian, and scene-linear radiance."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Protocol

import torch
from torch import Tensor

from matcap.brdf.cook_torrance import (
    Angles,
    LobeGradient,
    Reflectance,
    SurfaceParameters,
    dot,
    normalize,
    specular_lobe,
)
from matcap.brdf.maps import MapSet, by_slopes, normals_from_slopes
from matcap.files.threads import at_once
from matcap.flash.geometry import FlashSetup, camera_in_plane, points_of, project

# The flash's light on a surface: the differentiable renderer of flash photographs.
#
# A point light with inverse-square falloff and the Cook-Torrance reflectance
# (brdf/cook_torrance.py). No shadows: the flash is next to the lens, so the camera hardly sees what
# it does not light.
#
# L = (diffuse / pi + D G F / (4 (n.l)(n.v))) E,    E = I (n.l) / d^2.
#
# Precomputed are directions and power of a light at fixed points (`FlashLight`), and its irradiance
# on a fixed relief (`Incidence`). Any leading batch dimensions. `linearised` is the Jacobian of log
# L in closed form, for fits of maps to photographs (inputs of the network are finite differences).

# Squared distance from the centre of the corner of a 4:3 picture, the unit of vignetting.
CORNER_SQUARED = 1.25**2
DARKEST = 1e-5  # radiance (1 at clipping) below which logarithms are clamped
_STRIP = 1 << 16  # places whose intermediate values a processor's cache holds


class Incident(ABC):
    """Light incident on a relief."""

    irradiance: Tensor
    """(..., 1 or 3, H, W) E."""

    @abstractmethod
    def matte(self, albedo: Tensor) -> Tensor:
        """Radiance over irradiance (..., 3, H, W) of diffuse albedo (..., 3, H, W)."""

    @abstractmethod
    def mirrored(self, specular: Tensor, roughness: Tensor) -> Tensor:
        """Radiance over irradiance of F0 (..., 1 or 3, H, W) and roughness."""

    def diffuse(self, albedo: Tensor) -> Tensor:
        """Radiance (..., 3, H, W) of diffuse albedo (..., 3, H, W)."""
        return self.matte(albedo) * self.irradiance

    def specular(self, specular: Tensor, roughness: Tensor) -> Tensor:
        """Radiance (..., 1 or 3, H, W) mirrored by F0 (..., 1 or 3, H, W) and roughness."""
        return self.mirrored(specular, roughness) * self.irradiance

    def radiance(self, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
        """Diffuse plus specular radiance (..., 3, H, W)."""
        return self.diffuse(diffuse) + self.specular(specular, roughness)

    def log_radiance(self, surface: MapSet | Reflectance) -> tuple[Tensor, Tensor]:
        """(..., 3, H, W) each: log radiance, and the diffuse share of radiance."""
        diffuse = self.matte(surface.diffuse)
        reflected = (diffuse + self.mirrored(surface.specular, surface.roughness)).clamp_min(1e-12)
        return (reflected * self.irradiance).clamp_min(DARKEST).log(), diffuse / reflected


@dataclass(frozen=True)
class Incidence(Incident):
    """A point light's, with the direction to the camera."""

    angles: Angles
    """Angles between normal, light and view."""
    irradiance: Tensor
    """E; 0 where light or view is below the surface, unless Angles.quick."""

    def matte(self, albedo: Tensor) -> Tensor:
        """Lambertian."""
        return albedo / math.pi

    def mirrored(self, specular: Tensor, roughness: Tensor) -> Tensor:
        """The Cook-Torrance lobe."""
        return specular_lobe(specular, roughness, self.angles)


@dataclass(frozen=True)
class FlashLight:
    """Directions to a point light and a camera from points of the plane."""

    to_light: Tensor
    """(..., 3, H, W) unit vectors to the light."""
    to_view: Tensor
    """(..., 3, H, W) unit vectors to the camera."""
    power: Tensor
    """(..., 1 or 3, H, W) irradiance of a surface that faces the light."""

    @staticmethod
    def between(points: Tensor, camera: Tensor, light: Tensor, intensity: Tensor) -> FlashLight:
        """Light and camera at given positions, plane units.

        Args:
            points: (..., 3, H, W) lit points.
            camera: (3,) or (..., 3, 1, 1) position of the camera.
            light: (3,) or (..., 3, 1, 1) position of the light.
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
        """Light of a photograph's setup at plane points (..., 3, H, W), vignetting included."""
        camera, light = (v.to(points) for v in camera_in_plane(setup))
        intensity = torch.tensor(setup.intensity).to(points)[:, None, None]
        return FlashLight.between(points, camera, light, intensity * vignette(points, setup))

    @staticmethod
    def far(direction: Tensor) -> FlashLight:
        """Parallel light from a direction (3,), of irradiance 1 on the plane, seen from above."""
        to_light = normalize(_column(direction))
        above = to_light.new_tensor([0.0, 0.0, 1.0])
        return FlashLight(to_light, _column(above), 1.0 / to_light[2:])

    @cached_property
    def half(self) -> Tensor:
        """(..., 3, H, W) unit vectors halfway between light and camera."""
        return normalize(self.to_light + self.to_view)

    def cut(self, rows: slice, columns: slice) -> FlashLight:
        """The light at a rectangle of points."""
        return FlashLight(
            self.to_light[..., rows, columns],
            self.to_view[..., rows, columns],
            self.power[..., rows, columns],
        )

    def onto(self, normal: Tensor, *, exact: bool = False) -> Incidence:
        """Incidence on a relief.

        Args:
            normal: (..., 3, H, W) unit normals.
            exact: whether highlights of any width are accurate and the back side is dark; else
                single precision and radiance above 0, for logarithms and gradients (Angles.quick).
        """
        both = self.to_light, self.to_view
        angles = Angles.exact(normal, *both) if exact else Angles.quick(normal, *both, self.half)
        return Incidence(angles, angles.lit(self.power * angles.n_dot_l))

    def log_gradient(
        self, normal: Tensor, specular: Tensor, roughness: Tensor
    ) -> tuple[Incidence, Tensor, Tensor]:
        """As DifferentiableLight.log_gradient; the incidence is not exact."""
        lit = self.onto(normal)
        lobe = LobeGradient.of(specular, roughness, lit.angles)
        along = (
            lobe.n_dot_l * self.to_light + lobe.n_dot_v * self.to_view + lobe.n_dot_h * self.half
        )
        slanted = by_slopes(normal, self.to_light) / lit.angles.n_dot_l
        gloss = lobe.log_specular, lobe.logit_roughness
        return lit, torch.cat([*gloss, by_slopes(normal, along)]), slanted


class DifferentiableLight(Protocol):
    """A light at fixed points of the plane."""

    def onto(self, normal: Tensor) -> Incident:
        """Light incident on a relief of unit normals (..., 3, H, W)."""

    def log_gradient(
        self, normal: Tensor, specular: Tensor, roughness: Tensor
    ) -> tuple[Incident, Tensor, Tensor]:
        """Incidence on a relief, with derivatives of the logs of specular lobe and irradiance.

        Args:
            normal: (3, H, W) unit normals.
            specular, roughness: (1, H, W) F0 and roughness.

        Returns:
            The light incident on the relief; (4, H, W) derivatives of the lobe by log F0, logit
            roughness and both slopes; (2, H, W) of irradiance by both slopes.
        """


def linearised(
    light: DifferentiableLight, normal: Tensor, surface: MapSet | Reflectance
) -> tuple[Tensor, Tensor, Tensor]:
    """Log radiance (3, H, W) and its derivatives, which are those above DARKEST.

    These are the diffuse share s of radiance (3, H, W), which is d log L / d log albedo of its
    channel, and (4, 3, H, W) by log F0, logit roughness and both slopes:
    d log L = (1 - s) d log lobe + d log irradiance, the irradiance depending on slopes only. Of a
    coloured F0, the lobe is that of its mean.

    Args:
        normal: (3, H, W) unit normals.
    """
    grey = surface.specular.mean(0, keepdim=True)
    incident, lobe, slanted = light.log_gradient(normal, grey, surface.roughness)
    log, share = incident.log_radiance(surface)
    others = (1.0 - share) * lobe[:, None]
    others[2:] += slanted[:, None]
    return log, share, others


def strips(height: int, rows: int) -> list[slice]:
    """Slices of `rows` rows each, to bound memory or to work in the processor's cache."""
    return [slice(top, min(height, top + rows)) for top in range(0, height, rows)]


def cached_rows(width: int) -> int:
    """Rows of a picture whose shading fits the processor's cache."""
    return max(1, _STRIP // width)


def vignette(points: Tensor, setup: FlashSetup) -> Tensor:
    """(..., 3, H, W) share of light that reaches the sensor from plane points (..., 3, H, W)."""
    place = from_vignetting_centre(points.movedim(-3, 0), setup)
    lost = (setup.vignetting + more for more in setup.vignetting_colour)
    logs = [log_vignette(place, each, setup.vignetting_quartic) for each in lost]
    return torch.stack(logs, -3).exp()


def from_vignetting_centre(points: Tensor, setup: FlashSetup) -> Tensor:
    """(2, ...) image coordinates of plane points (3, ...), from the vignetting's centre."""
    x, y = project(points, setup)
    across, up = setup.vignetting_centre
    return torch.stack([x - across, y - up])


def log_vignette(place: Tensor, vignetting: float | Tensor, quartic: float | Tensor) -> Tensor:
    """(...) logarithm of that share, -a s - b s^2 (FlashSetup), (2, ...) from its centre."""
    squared = place.square().sum(0) / CORNER_SQUARED
    return -squared * (vignetting + quartic * squared)


def _column(vector: Tensor) -> Tensor:
    """(3,) to (3, 1, 1)."""
    return vector[:, None, None] if vector.ndim == 1 else vector


# Map sets and uniform materials under a flash, to scene-linear radiance.


def shade(maps: MapSet, points: Tensor, camera: Tensor, light: Tensor, intensity: Tensor) -> Tensor:
    """Radiance of a point-lit material seen from a camera, (..., 3, H, W).

    Args:
        maps: the material at `points`; shadows are neglected.
        points, camera, light, intensity: as of FlashLight.between.
    """
    return _picture(
        maps, lambda rows: FlashLight.between(points[..., rows, :], camera, light, intensity)
    )


def render_flash(maps: MapSet, setup: FlashSetup, points: Tensor) -> Tensor:
    """Scene-linear picture of a material under the setup's own flash, (..., 3, H, W).

    Not clipped. `points` are the plane points of the texels (plane_points), which determine the
    directions of light and view.
    """
    return _picture(maps, lambda rows: FlashLight.of(setup, points[..., rows, :]))


def render_rectified(maps: MapSet, setup: FlashSetup) -> Tensor:
    """The flash picture of maps spanning the whole plane rectangle, on the plane's own grid.

    The long side spans two plane units at any texel size: x in [-1, 1], or y if the setup is turned
    and maps and picture are upright.
    """
    if setup.turned:
        landscape = render_rectified(maps.turned(1), replace(setup, turned=False))
        return landscape.rot90(-1, (-2, -1))
    points = partial(points_of, maps.size[::-1])
    return _picture(maps, lambda rows: FlashLight.of(setup, points(rows).to(maps.height)))


def _picture(maps: MapSet, light_at: Callable[[slice], FlashLight]) -> Tensor:
    def some(rows: slice) -> Tensor:
        incidence = light_at(rows).onto(maps.normals_of(rows), exact=True)
        materials = (maps.diffuse, maps.specular, maps.roughness)
        return incidence.radiance(*(values[..., rows, :] for values in materials))

    width, height = maps.size
    parts = (partial(some, rows) for rows in strips(height, cached_rows(width)))
    return torch.cat(at_once(*parts), dim=-2)


@dataclass(frozen=True)
class Uniform:
    """A uniform material and the camera and flash of its photograph."""

    diffuse: tuple[float, float, float]
    """(r, g, b) diffuse albedo."""
    specular: float
    """Specular albedo F0."""
    roughness: float
    """GGX roughness, in (0, 1)."""
    setup: FlashSetup
    """Camera, flash and tilt; its intensity is determined only as a product with albedo and F0."""

    def logits(self) -> Tensor:
        """(5,) logits of diffuse albedo (3), F0 and roughness."""
        return torch.logit(torch.tensor([*self.diffuse, self.specular, self.roughness]), eps=1e-4)

    def parameters(self) -> SurfaceParameters:
        """Log parameters, (..., 1, 1) each, to which the maps' residuals are added."""
        return SurfaceParameters.uniform(self.diffuse, self.specular, self.roughness)


def uniform_radiance(
    uniform: Uniform,
    light: FlashLight,
    slopes: tuple[Tensor, Tensor] | None = None,
    *,
    duller: float = 0.0,
) -> tuple[Tensor, Tensor]:
    """Radiance (..., 3, H, W) of the uniform material under its flash, and its diffuse part.

    Args:
        light: of that setup, at (3, H, W) points.
        slopes: (dh/dx, dh/dy), (..., 1, H, W) each; flat by default.
        duller: added to the logit of roughness.
    """
    one = torch.ones_like(light.power[..., :1, :, :])
    across, up = slopes if slopes is not None else (0.0 * one, 0.0 * one)
    incidence = light.onto(normals_from_slopes(across, up), exact=True)
    albedo = torch.tensor(uniform.diffuse).to(one)[:, None, None]
    roughness = torch.sigmoid(uniform.parameters().roughness + duller).to(one) * one
    diffuse = incidence.diffuse(albedo)
    return diffuse + incidence.specular(uniform.specular * one, roughness), diffuse
