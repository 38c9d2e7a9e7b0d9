"""A uniform material under a photograph's flash: what a coarse fit finds, and how it would look."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.brdf.cook_torrance import cook_torrance, dot, normalize
from matcap.brdf.normals import normals_from_slopes
from matcap.flash.geometry import FlashSetup, camera_in_plane
from matcap.flash.render import vignette


@dataclass(frozen=True)
class Uniform:
    """A uniform material and the setup it was photographed with.

    Attributes:
        diffuse: (r, g, b) albedo.
        specular: F0.
        roughness: in (0, 1).
        setup: camera, flash, tilt; its intensity belongs to these albedos.
    """

    diffuse: tuple[float, float, float]
    specular: float
    roughness: float
    setup: FlashSetup

    def logits(self) -> Tensor:
        """(5,) of diffuse albedo, F0 and roughness."""
        return torch.logit(torch.tensor([*self.diffuse, self.specular, self.roughness]), eps=1e-4)


def uniform_radiance(
    uniform: Uniform,
    points: Tensor,
    slope: tuple[float | Tensor, float | Tensor] = (0.0, 0.0),
    duller: float = 0.0,
) -> tuple[Tensor, Tensor]:
    """Radiance (3, H, W) of the uniform material at plane points, and its diffuse part.

    Args:
        uniform: the material and its setup.
        points: (3, H, W).
        slope: (dh/dx, dh/dy) of the whole plane, or of its places, as (H, W) spreads.
        duller: added to the logit of roughness.
    """
    setup = uniform.setup
    camera, light = (v.to(points)[:, None, None] for v in camera_in_plane(setup))
    away = light - points
    to_light, to_view = normalize(away), normalize(camera - points)
    one = torch.ones_like(points[:1])
    normal = normals_from_slopes(slope[0] * one, slope[1] * one)
    rough = (
        torch.sigmoid(torch.tensor(roughness_logit(uniform.roughness) + duller)).to(points) * one
    )
    albedo = torch.tensor(uniform.diffuse).to(points)[:, None, None]
    falloff = dot(normal, to_light).clamp_min(1e-4) / dot(away, away) * vignette(points, setup)
    power = torch.tensor(setup.intensity).to(points)[:, None, None] * falloff
    whole = cook_torrance(albedo, uniform.specular * one, rough, normal, to_light, to_view)
    return whole * power, albedo / math.pi * power


def roughness_logit(value: float) -> float:
    """The logit of a roughness, which is kept off its ends."""
    inside = min(max(value, 0.001), 0.999)
    return math.log(inside / (1.0 - inside))
