"""Specular tint of metal: divided out before the multi-view solution, multiplied back after it.

With F0 = tint f, f the mean of F0 over channels, and irradiance E, radiance by channel is

    L = E (diffuse / pi + tint f lobe) = tint E (diffuse / tint / pi + f lobe).

So log L - log tint is solved for the albedo diffuse / tint and an achromatic F0 = f, by the same
solver as for dielectrics. Schlick's achromatic rise to 1 at grazing angles is neglected.
"""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.parameters import ALBEDO_LIMITS, F0_LIMITS

GREY = torch.ones(1, 1, 1)  # the tint without metal


def achromatic(maps: MapSet) -> tuple[MapSet, Tensor]:
    """Maps with diffuse / tint and mean F0 (1, H, W), and the tint; 1 (1, H, W) of achromatic F0.

    tint = F0 / mean of F0 over channels.
    """
    f0 = maps.specular.clamp_min(F0_LIMITS[0])
    mean = maps.specular.mean(-3, keepdim=True).clamp_min(F0_LIMITS[0])
    tint = f0 / mean
    tint = tint / tint.mean(-3, keepdim=True)
    return replace(maps, diffuse=(maps.diffuse / tint).clamp(*ALBEDO_LIMITS), specular=mean), tint


def coloured(maps: MapSet, tint: Tensor) -> MapSet:
    """The inverse of achromatic: diffuse and F0 times a tint (1 or 3, h, w) on any grid."""
    tint = on_grid(tint, maps.size)
    return replace(
        maps,
        diffuse=(maps.diffuse * tint).clamp(*ALBEDO_LIMITS),
        specular=(maps.specular * tint).clamp(*F0_LIMITS),
    )


def on_grid(tint: Tensor, size: tuple[int, int]) -> Tensor:
    """(1 or 3, height, width) tint resampled bilinearly to `size` = (width, height)."""
    if tint.shape[-2:] == size[::-1]:
        return tint
    return F.interpolate(tint[None], size=size[::-1], mode="bilinear", align_corners=False)[0]
