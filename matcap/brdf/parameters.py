"""Unconstrained parameters of a surface, for networks and optimisers.

log diffuse albedo, log F0, logit roughness, height in texels; with the limits that reflectance is
clamped to. Stacked channels are ordered as in MapSet.stacked.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor

from matcap.brdf.maps import CHANNELS, MapSet, split_stacked

# Of a parameter vector of one surface or texel: log albedo (3), log F0, logit roughness.
ALBEDO, F0, ROUGH = slice(0, 3), 3, 4
REFLECTANCE = {name: count for name, count in CHANNELS.items() if name != "height"}

ALBEDO_LIMITS = (0.001, 0.99)  # of a diffuse channel
F0_LIMITS = (0.005, 0.99)
ROUGHNESS_LIMITS = (0.001, 0.999)
_ROUGHNESS_LOGITS = 7.0  # largest |logit|: slightly beyond ROUGHNESS_LIMITS, which thus round-trip


class Reflectance(NamedTuple):
    """Reflectance maps, a MapSet's without the height."""

    diffuse: Tensor
    """(..., 3, H, W) diffuse albedo."""
    specular: Tensor
    """(..., 1, H, W) F0; 3 channels if coloured."""
    roughness: Tensor
    """(..., 1, H, W) perceptual roughness."""


@dataclass(frozen=True)
class SurfaceParameters:
    """Parameters of a surface, or differences of two surfaces' parameters.

    Shapes need only broadcast with each other.
    """

    diffuse: Tensor
    """(..., 3, H, W) log of diffuse albedo."""
    specular: Tensor
    """(..., 1, H, W) log of F0; 3 channels if coloured."""
    roughness: Tensor
    """(..., 1, H, W) logit of perceptual roughness."""
    height: Tensor
    """(..., 1, H, W) in texels."""

    @staticmethod
    def of(maps: MapSet) -> SurfaceParameters:
        """Parameters of maps, whose reflectance is clamped to the limits."""
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
        """Parameters of a flat, uniform surface, (..., 1, 1) each; only roughness is clamped."""
        gloss = torch.tensor([specular, roughness], dtype=torch.float64)[:, None, None, None]
        return SurfaceParameters(
            torch.tensor(diffuse).log()[:, None, None],
            gloss[0].log().float(),
            gloss[1].clamp(*ROUGHNESS_LIMITS).logit().float(),
            torch.zeros(1, 1, 1),
        )

    def reflectance(self) -> Reflectance:
        """The reflectance, clamped to the limits."""
        return Reflectance(
            self.diffuse.exp().clamp(*ALBEDO_LIMITS),
            self.specular.exp().clamp(*F0_LIMITS),
            torch.sigmoid(self.roughness.clamp(-_ROUGHNESS_LOGITS, _ROUGHNESS_LOGITS)),
        )

    def maps(self, texel_size: float) -> MapSet:
        """Maps, clamped to the limits; texel_size in plane units."""
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
        """Converted to a tensor's device and dtype."""
        return SurfaceParameters(*(getattr(self, f.name).to(like) for f in fields(self)))

    def vector(self) -> Tensor:
        """(5,) ALBEDO, F0 and ROUGH of a flat, uniform surface."""
        return torch.cat([self.diffuse, self.specular, self.roughness]).flatten()

    @staticmethod
    def from_vector(vector: Tensor) -> SurfaceParameters:
        """A flat, uniform surface with these parameters (5,), the inverse of vector()."""
        diffuse, specular, roughness = vector[:, None, None].split(list(REFLECTANCE.values()))
        return SurfaceParameters(diffuse, specular, roughness, torch.zeros_like(specular))

    def stacked(self) -> Tensor:
        """(..., 6 or 8, H, W), channels as in MapSet.stacked."""
        return torch.cat([self.diffuse, self.specular, self.roughness, self.height], dim=-3)

    @staticmethod
    def from_stacked(stacked: Tensor) -> SurfaceParameters:
        """The inverse of stacked()."""
        return SurfaceParameters(*split_stacked(stacked))
