"""The differentiable flash renderer: maps and a setup to scene-linear radiance.

A point light at the flash's place, inverse-square falloff, the Cook-Torrance reflectance, no
shadows (the flash sits beside the lens, so what it cannot reach the camera hardly sees).
"""

from __future__ import annotations

import torch
from torch import Tensor

from matcap.brdf.cook_torrance import cook_torrance, dot, normalize
from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup, camera_in_plane, plane_points, project

# Corner of a 4:3 picture: its squared distance from the middle, where vignetting is stated.
CORNER_SQUARED = 1.25**2


def shade(maps: MapSet, points: Tensor, camera: Tensor, light: Tensor, intensity: Tensor) -> Tensor:
    """Radiance of a point-lit material seen from a camera, (..., 3, H, W).

    Args:
        maps: the material at `points`; its slopes are small enough to ignore its own shadows.
        points: (..., 3, H, W) places on the plane, in plane units.
        camera: (3,) or (..., 3, 1, 1) place of the camera.
        light: likewise, of the point light.
        intensity: (3,) or (..., 3, 1, 1) radiant intensity of the light.
    """
    camera, light, intensity = (_column(v) for v in (camera, light, intensity))
    to_light = light - points
    squared_distance = dot(to_light, to_light)
    to_light = normalize(to_light)
    to_view = normalize(camera - points)
    normal = maps.normal
    reflectance = cook_torrance(
        maps.diffuse, maps.specular, maps.roughness, normal, to_light, to_view
    )
    cosine = dot(normal, to_light).clamp_min(0.0)
    return reflectance * cosine * intensity / squared_distance


def vignette(points: Tensor, setup: FlashSetup) -> Tensor:
    """(..., 1, H, W) share of light that reaches the sensor from plane points (..., 3, H, W)."""
    image = project(points.movedim(-3, 0), setup)
    squared = image.square().sum(0).unsqueeze(-3) / CORNER_SQUARED
    return torch.exp(-squared * (setup.vignetting + setup.vignetting_quartic * squared))


def render_flash(maps: MapSet, setup: FlashSetup, points: Tensor) -> Tensor:
    """Scene-linear picture of a material under the setup's own flash, (..., 3, H, W).

    Not clipped. `points` are the plane points of the maps' texels (plane_points), so that a
    window is lit and seen as where it was cut.
    """
    camera, light = (v.to(points) for v in camera_in_plane(setup))
    intensity = torch.tensor(setup.intensity, dtype=points.dtype, device=points.device)
    return shade(maps, points, camera, light, intensity) * vignette(points, setup)


def render_rectified(maps: MapSet, setup: FlashSetup) -> Tensor:
    """The flash picture of maps spanning the whole plane rectangle, on the plane's own grid.

    The maps' width spans x in [-1, 1] whatever their texel size says.
    """
    width, height = maps.size
    points = plane_points(0, 0, width, height, (width, height), dtype=maps.height.dtype)
    return render_flash(maps, setup, points.to(maps.height.device))


def _column(vector: Tensor) -> Tensor:
    return vector[:, None, None] if vector.ndim == 1 else vector
