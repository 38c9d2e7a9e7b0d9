"""Pictures of map sets under a flash: maps and a setup to scene-linear radiance (light.py)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
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
        lying = render_rectified(maps.turned(1), replace(setup, turned=False))
        return lying.rot90(-1, (-2, -1))
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
