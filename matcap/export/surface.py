"""What a target makes of a material, and how far that is from what matcap means by it.

Targets differ from matcap's reflectance (brdf/cook_torrance.py) in a few ways only: where Fresnel
ends at grazing, whether what is reflected is taken from the diffuse part, and which masking they
know. A TargetSurface says these things of a target, with the maps as its files hold them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Literal

import torch
from torch import Tensor

from matcap.brdf.cook_torrance import MIN_ROUGHNESS, dot, ggx, normalize, smith_visibility
from matcap.brdf.maps import MapSet

# Directions under which surfaces are compared: cosines of view and light, and the angle between.
_VIEWS = (0.0, 45.0)
_LIGHTS = (15.0, 40.0, 65.0)
_AROUND = (0.0, 90.0, 180.0, 270.0)
# At most about this many texels are compared, evenly spread.
_TEXELS = 65_536


@dataclass(frozen=True)
class TargetSurface:
    """Parameters of a target's reflectance, per texel.

    Attributes:
        diffuse: (3, H, W).
        f0: (1, H, W) or (3, H, W) reflectance at normal incidence.
        roughness: (1, H, W); alpha is its square.
        normal: (3, H, W), +Y up; need not be of unit length.
        f90: reflectance at grazing, a number or a tensor like f0.
        layer: F0 of a layer above the diffuse part, which is multiplied by 1 - F(v.h) of it (glTF,
            UsdPreviewSurface); a number or a tensor like f0; None where there is no such layer.
        masking: height-correlated Smith, or the product of both directions' ("separable").
    """

    diffuse: Tensor
    f0: Tensor
    roughness: Tensor
    normal: Tensor
    f90: float | Tensor = 1.0
    layer: float | Tensor | None = None
    masking: Literal["correlated", "separable"] = "correlated"

    @staticmethod
    def of_maps(maps: MapSet) -> TargetSurface:
        """What matcap means by a map set."""
        return TargetSurface(maps.diffuse, maps.specular, maps.roughness, maps.normal)

    def every(self, step: int) -> TargetSurface:
        """Every step-th texel of every step-th row, in float64."""

        def thin(value: Any) -> Any:  # noqa: ANN401
            return value[..., ::step, ::step].double() if isinstance(value, Tensor) else value

        return TargetSurface(
            **{field.name: thin(getattr(self, field.name)) for field in fields(self)}
        )

    def shine(self, to_light: Tensor, to_view: Tensor) -> Tensor:
        """(3, H, W) reflectance times n.l; 0 where light or view is below the surface.

        Args:
            to_light, to_view: (3, H, W) or (3, 1, 1) unit vectors.
        """
        normal = normalize(self.normal)
        n_dot_l, n_dot_v = dot(normal, to_light), dot(normal, to_view)
        above = (n_dot_l > 0) & (n_dot_v > 0)
        half = normalize(to_light + to_view)
        grazing = (1.0 - dot(to_view, half)).clamp(0.0, 1.0) ** 5
        fresnel = self.f0 + (self.f90 - self.f0) * grazing
        alpha = self.roughness.clamp_min(MIN_ROUGHNESS).square()
        n_dot_h = dot(normal, half)
        spread = ggx(n_dot_h, (1.0 - n_dot_h.square()).clamp_min(0.0), alpha)
        seen = self._visibility(n_dot_l.clamp_min(0.0), n_dot_v.clamp_min(0.0), alpha)
        diffuse = self.diffuse / math.pi
        if self.layer is not None:
            above_it = self.layer + (1.0 - self.layer) * grazing
            diffuse = diffuse * (1.0 - above_it.amax(dim=-3, keepdim=True))
        value = (diffuse + spread * seen * fresnel) * n_dot_l
        return torch.where(above, value, torch.zeros_like(value))

    def _visibility(self, n_dot_l: Tensor, n_dot_v: Tensor, alpha: Tensor) -> Tensor:
        if self.masking == "correlated":
            return smith_visibility(n_dot_l, n_dot_v, alpha)

        def one(cosine: Tensor) -> Tensor:
            squared = alpha.square()
            return 1.0 / (cosine + torch.sqrt(squared + (1.0 - squared) * cosine.square()))

        return one(n_dot_l) * one(n_dot_v)


@dataclass(frozen=True)
class Residual:
    """How far a target's light is from matcap's, as a share of matcap's light.

    Attributes:
        mean: over all texels, views and lights.
        worst: of any one view and light, over all texels.
    """

    mean: float
    worst: float

    def __str__(self) -> str:
        return f"{self.mean:.2%} of the light on average, {self.worst:.2%} at worst"


def residual(maps: MapSet, surface: TargetSurface) -> Residual:
    """How far a target's surface is from what matcap means by the maps.

    Reflected radiance of both, straight from above and at 45 degrees, under lights 15, 40 and 65
    degrees from the vertical on four sides; absolute differences, summed over at most about
    65,000 evenly spread texels, divided by matcap's sum.
    """
    width, height = maps.size
    step = max(1, math.ceil(math.sqrt(width * height / _TEXELS)))
    ours, theirs = TargetSurface.of_maps(maps).every(step), surface.every(step)
    off, total, worst = 0.0, 0.0, 0.0
    for view in _VIEWS:
        for tilt in _LIGHTS:
            for around in _AROUND:
                directions = _direction(tilt, around), _direction(view, 0.0)
                true = ours.shine(*directions)
                error = float((theirs.shine(*directions) - true).abs().sum())
                light = float(true.sum())
                off, total = off + error, total + light
                worst = max(worst, error / light if light > 0.0 else 0.0)
    return Residual(off / total if total > 0.0 else 0.0, worst)


def _direction(tilt: float, around: float) -> Tensor:
    """(3, 1, 1) unit vector at an angle from +z, turned about it; degrees."""
    t, a = math.radians(tilt), math.radians(around)
    vector = (math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t))
    return torch.tensor(vector, dtype=torch.float64)[:, None, None]
