"""A uniform material under a flash: the coarse fit's parameters, and their rendering."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.brdf.normals import normals_from_slopes
from matcap.brdf.parameters import SurfaceParameters
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import FlashLight


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
