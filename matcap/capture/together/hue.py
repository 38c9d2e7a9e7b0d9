"""Specular tint of metal in a set: divided out while solving, and multiplied back.

Radiance is E (diffuse / pi + hue lobe) by channel, F0 being its mean times a hue. That is hue times
what a grey F0 under the same light shows of an albedo of diffuse / hue. So photographs less the
logarithm of hue are solved with one number of F0 a texel, as those of all other materials are. What
Schlick adds to F0 at grazing angles, which has no hue, is left out of that.
"""

from __future__ import annotations

from dataclasses import replace

import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import COLOURED, MapSet
from matcap.brdf.parameters import ALBEDO_LIMITS, F0_LIMITS


def achromatic(maps: MapSet) -> tuple[MapSet, Tensor | None]:
    """Maps as they are solved, and the hue (3, H, W) that was taken off; None where F0 is grey."""
    if maps.specular.shape[-3] < COLOURED:
        return maps, None
    mean = maps.specular.mean(-3, keepdim=True).clamp_min(F0_LIMITS[0])
    hue = maps.specular.clamp_min(F0_LIMITS[0]) / mean
    hue = hue / hue.mean(-3, keepdim=True)
    return replace(maps, diffuse=(maps.diffuse / hue).clamp(*ALBEDO_LIMITS), specular=mean), hue


def coloured(maps: MapSet, hue: Tensor | None) -> MapSet:
    """The inverse; hue on any grid."""
    if hue is None:
        return maps
    here = on_grid(hue, maps.size)
    return replace(
        maps,
        diffuse=(maps.diffuse * here).clamp(*ALBEDO_LIMITS),
        specular=(maps.specular * here).clamp(*F0_LIMITS),
    )


def on_grid(hue: Tensor, size: tuple[int, int]) -> Tensor:
    """(3, h, w) of a hue on another grid of (width, height) texels."""
    if hue.shape[-2:] == size[::-1]:
        return hue
    return F.interpolate(hue[None], size=size[::-1], mode="bilinear", align_corners=False)[0]
