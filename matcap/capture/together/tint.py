"""Specular tint of metal in a set: divided out while solving, and multiplied back.

With F0 = tint f, f being its mean over channels, radiance by channel is

    L = E (diffuse / pi + tint f lobe) = tint E (diffuse / tint / pi + f lobe).

So log L - log tint is solved for an albedo of diffuse / tint and one F0 a texel, as of all other
materials. Schlick's rise to 1 at grazing angles, which has no tint, is neglected.
"""

from __future__ import annotations

from dataclasses import replace

import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import COLOURED, MapSet
from matcap.brdf.parameters import ALBEDO_LIMITS, F0_LIMITS


def achromatic(maps: MapSet) -> tuple[MapSet, Tensor | None]:
    """Maps as they are solved, and the tint (3, H, W) that was taken off; None where F0 is grey."""
    if maps.specular.shape[-3] < COLOURED:
        return maps, None
    mean = maps.specular.mean(-3, keepdim=True).clamp_min(F0_LIMITS[0])
    tint = maps.specular.clamp_min(F0_LIMITS[0]) / mean
    tint = tint / tint.mean(-3, keepdim=True)
    return replace(maps, diffuse=(maps.diffuse / tint).clamp(*ALBEDO_LIMITS), specular=mean), tint


def coloured(maps: MapSet, tint: Tensor | None) -> MapSet:
    """The inverse; tint on any grid."""
    if tint is None:
        return maps
    here = on_grid(tint, maps.size)
    return replace(
        maps,
        diffuse=(maps.diffuse * here).clamp(*ALBEDO_LIMITS),
        specular=(maps.specular * here).clamp(*F0_LIMITS),
    )


def on_grid(tint: Tensor, size: tuple[int, int]) -> Tensor:
    """(3, h, w) of a tint on another grid of (width, height) texels."""
    if tint.shape[-2:] == size[::-1]:
        return tint
    return F.interpolate(tint[None], size=size[::-1], mode="bilinear", align_corners=False)[0]
