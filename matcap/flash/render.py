"""Map sets and uniform materials under a flash: to scene-linear radiance (light.py)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.normals import normals_from_slopes
from matcap.brdf.parameters import SurfaceParameters
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import FlashLight, cached_rows, strips


def shade(maps: MapSet, points: Tensor, camera: Tensor, light: Tensor, intensity: Tensor) -> Tensor:
    """Radiance of a point-lit material seen from a camera, (..., 3, H, W).

    Args:
        maps: the material at `points`; shadows are neglected.
        points, camera, light, intensity: as of FlashLight.between.
    """
    return _picture(maps, points, lambda some: FlashLight.between(some, camera, light, intensity))


def render_flash(maps: MapSet, setup: FlashSetup, points: Tensor) -> Tensor:
    """Scene-linear picture of a material under the setup's own flash, (..., 3, H, W).

    Not clipped. `points` are the plane points of the texels (plane_points), which determine the
    directions of light and view.
    """
    return _picture(maps, points, lambda some: FlashLight.of(setup, some))


def render_rectified(maps: MapSet, setup: FlashSetup) -> Tensor:
    """The flash picture of maps spanning the whole plane rectangle, on the plane's own grid.

    The long side spans two plane units at any texel size: x in [-1, 1], or y if the setup is turned
    and maps and picture are upright.
    """
    if setup.turned:
        landscape = render_rectified(maps.turned(1), replace(setup, turned=False))
        return landscape.rot90(-1, (-2, -1))
    width, height = maps.size
    points = plane_points(0, 0, width, height, (width, height), dtype=maps.height.dtype)
    return render_flash(maps, setup, points.to(maps.height.device))


def _picture(maps: MapSet, points: Tensor, light_at: Callable[[Tensor], FlashLight]) -> Tensor:
    normal = maps.normal

    def some(rows: slice) -> Tensor:
        normals, *materials = (
            values[..., rows, :] for values in (normal, maps.diffuse, maps.specular, maps.roughness)
        )
        return light_at(points[..., rows, :]).onto(normals, exact=True).radiance(*materials)

    height, width = points.shape[-2:]
    return torch.cat([some(rows) for rows in strips(height, cached_rows(width))], dim=-2)


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
        uniform: the material and its setup.
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
