"""Unconstrained reflectance parameters (logs and logits), for networks and optimisers.

Logarithms of diffuse albedo and F0, the logit of roughness, heights in texels. One way in and one
way out, and here stand the limits of what a surface is taken for. Channels go by their names; in a
tensor they lie as in a stacked MapSet.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor

from matcap.brdf.maps import CHANNELS, MapSet, split_stacked

REFLECTANCE = {name: count for name, count in CHANNELS.items() if name != "height"}

ALBEDO_LIMITS = (0.001, 0.99)  # least and most of a diffuse channel
F0_LIMITS = (0.005, 0.99)
ROUGHNESS_LIMITS = (0.001, 0.999)
_ROUGHNESS_LOGITS = 7.0  # either way: a little beyond ROUGHNESS_LIMITS, so that its ends come back


class Reflectance(NamedTuple):
    """What a surface reflects, without its relief; a MapSet's maps of these names.

    Attributes:
        diffuse: (..., 3, H, W) diffuse albedo.
        specular: (..., 1, H, W) F0; 3 channels where it has a colour.
        roughness: (..., 1, H, W).
    """

    diffuse: Tensor
    specular: Tensor
    roughness: Tensor


@dataclass(frozen=True)
class SurfaceParameters:
    """A surface, or what two surfaces differ by; any shapes that broadcast with each other."""

    diffuse: Tensor
    """(..., 3, H, W) log of diffuse albedo."""
    specular: Tensor
    """(..., 1, H, W) log of F0; 3 channels where it has a colour."""
    roughness: Tensor
    """(..., 1, H, W) logit of perceptual roughness."""
    height: Tensor
    """(..., 1, H, W) in texels."""

    @staticmethod
    def of(maps: MapSet) -> SurfaceParameters:
        """Of maps, brought within the limits."""
        return SurfaceParameters(
            maps.diffuse.clamp(*ALBEDO_LIMITS).log(),
            maps.specular.clamp(*F0_LIMITS).log(),
            maps.roughness.clamp(*ROUGHNESS_LIMITS).logit(),
            maps.height / maps.texel_size,
        )

    @staticmethod
    def uniform(
        diffuse: tuple[float, float, float], specular: float, roughness: float
    ) -> SurfaceParameters:
        """Of a flat, uniform surface, (..., 1, 1) each; only roughness is kept off its ends."""
        gloss = torch.tensor([specular, roughness], dtype=torch.float64)[:, None, None, None]
        return SurfaceParameters(
            torch.tensor(diffuse).log()[:, None, None],
            gloss[0].log().float(),
            gloss[1].clamp(*ROUGHNESS_LIMITS).logit().float(),
            torch.zeros(1, 1, 1),
        )

    def reflectance(self) -> Reflectance:
        """Within the limits."""
        return Reflectance(
            self.diffuse.exp().clamp(*ALBEDO_LIMITS),
            self.specular.exp().clamp(*F0_LIMITS),
            torch.sigmoid(self.roughness.clamp(-_ROUGHNESS_LOGITS, _ROUGHNESS_LOGITS)),
        )

    def maps(self, texel_size: float) -> MapSet:
        """Maps within the limits, of texels of a size in plane units."""
        return MapSet(*self.reflectance(), self.height * texel_size, texel_size)

    def __add__(self, other: SurfaceParameters) -> SurfaceParameters:
        return SurfaceParameters(
            *(getattr(self, f.name) + getattr(other, f.name) for f in fields(self))
        )

    def __sub__(self, other: SurfaceParameters) -> SurfaceParameters:
        return SurfaceParameters(
            *(getattr(self, f.name) - getattr(other, f.name) for f in fields(self))
        )

    def to(self, like: Tensor) -> SurfaceParameters:
        """On a tensor's device, in its precision."""
        return SurfaceParameters(*(getattr(self, f.name).to(like) for f in fields(self)))

    def levels(self) -> Tensor:
        """(5,) diffuse, specular and roughness of a flat, uniform surface."""
        return torch.cat([self.diffuse, self.specular, self.roughness]).flatten()

    @staticmethod
    def from_levels(levels: Tensor) -> SurfaceParameters:
        """The inverse of levels()."""
        diffuse, specular, roughness = levels[:, None, None].split(list(REFLECTANCE.values()))
        return SurfaceParameters(diffuse, specular, roughness, torch.zeros_like(specular))

    def stacked(self) -> Tensor:
        """(..., 6 or 8, H, W), channels as in MapSet.stacked."""
        return torch.cat([self.diffuse, self.specular, self.roughness, self.height], dim=-3)

    @staticmethod
    def from_stacked(stacked: Tensor) -> SurfaceParameters:
        """The inverse of stacked()."""
        return SurfaceParameters(*split_stacked(stacked))
