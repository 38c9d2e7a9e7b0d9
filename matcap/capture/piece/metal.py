"""Metal in the exemplar: its share of each texel and its specular tint.

Dielectrics have an achromatic F0. Metals have no diffuse albedo, so under a white flash their
radiance has the colour of F0. With the metal share m of a texel from the network and the base
colour from the photograph,

    diffuse = base (1 - m),    F0 = f (1 - m) + base m,

f being the achromatic F0 of the dielectric. A fractional m is an area mixture.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

_LEAST_SHARE = 0.005  # least share of metal in an exemplar
_AROUND = 5  # side, texels, of the neighbourhood whose colour is averaged, against noise
# Radiance (1 at clipping) at which the local colour weighs as much as the mean: darker texels
# mirror little, and show dirt and noise.
_DARK = 0.05
_LEAST = 1e-6


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
    whole = (counted * bright).sum((-2, -1), keepdim=True) + _LEAST
    return whole / whole.mean(-3, keepdim=True)


def has_metal(logit: Tensor) -> bool:
    """Whether the network's logit of metal (1, H, W) predicts more than hardly any."""
    return float((logit > 0.0).float().mean()) > _LEAST_SHARE


def tint(metal: Tensor, colour: Tensor) -> Tensor:
    """(..., 3, H, W) specular tint, F0 over its channel mean: 1 without metal.

    Args:
        metal: (..., 1, H, W) share of metal, in [0, 1].
        colour: (..., 3, H, W) colour of the metal (seen_colour).
    """
    return 1.0 + metal * (colour - 1.0)


def _mean(picture: Tensor) -> Tensor:
    """Local mean with equal weights, so that channels are averaged over the same texels."""
    flat = picture.reshape(-1, *picture.shape[-3:])
    pad = _AROUND // 2
    blurred = F.avg_pool2d(flat, _AROUND, stride=1, padding=pad)
    return torch.as_tensor(blurred.reshape(picture.shape))
