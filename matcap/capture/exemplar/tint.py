"""Specular tint of metal: F0 over the mean of its channels.

Dielectrics have an achromatic F0. Metals have no diffuse albedo, so under a white flash their
radiance has the colour of F0: with the share m of metal in a texel and the colour of radiance,
normalised to a channel mean of 1, the specular tint of the texel is 1 + m (colour - 1).

For several photographs it is divided out before the solution, and multiplied back after it. With
F0 = tint f, f the mean of F0 over channels, and irradiance E, radiance by channel is

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

_LEAST_SHARE = 0.005  # least share of metal in an exemplar
_COLOUR_SIDE = 5  # texels, side of the neighbourhood whose colour is averaged, against noise
# Radiance (1 at clipping) at which the local colour weighs as much as the mean: darker texels
# mirror little, and show dirt and noise.
_DARK = 0.05


def seen_colour(linear: Tensor, weight: Tensor) -> Tensor:
    """(..., 3, H, W) local mean colour of radiance, normalised to a channel mean of 1.

    Args:
        linear: (..., 3, H, W) radiance.
        weight: (..., 1, H, W) weight of a texel, 0 if clipped. Without weight nearby, the result is
            the mean colour of the whole; without any, grey.
    """
    counted = linear.clamp_min(0.0) * weight.to(linear)
    around = _mean(counted) + _DARK * whole_colour(linear, weight)
    return around / around.mean(-3, keepdim=True)


def whole_colour(linear: Tensor, weight: Tensor) -> Tensor:
    """(..., 3, 1, 1) mean colour, weighted by brightness; arguments as of seen_colour."""
    counted = linear.clamp_min(0.0) * weight.to(linear)
    bright = counted.mean(-3, keepdim=True)
    whole = (counted * bright).sum((-2, -1), keepdim=True) + 1e-6
    return whole / whole.mean(-3, keepdim=True)


def has_metal(logit: Tensor) -> bool:
    """Whether the network's logit of metal (1, H, W) predicts more than hardly any."""
    return float((logit > 0.0).float().mean()) > _LEAST_SHARE


def specular_tint(metal: Tensor, colour: Tensor) -> Tensor:
    """(..., 3, H, W) specular tint, F0 over its channel mean: 1 without metal.

    Args:
        metal: (..., 1, H, W) share of metal, in [0, 1].
        colour: (..., 3, H, W) colour of the metal (seen_colour).
    """
    return 1.0 + metal * (colour - 1.0)


def _mean(picture: Tensor) -> Tensor:
    """Local mean with equal weights, so that channels are averaged over the same texels."""
    flat = picture.reshape(-1, *picture.shape[-3:])
    pad = _COLOUR_SIDE // 2
    blurred = F.avg_pool2d(flat, _COLOUR_SIDE, stride=1, padding=pad)
    return torch.as_tensor(blurred.reshape(picture.shape))


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
