"""The base: offset and scale of the decoder's raw outputs, from the coarse fit.

    raw = mean + deviation * output

The network then learns differences from the coarse fit only. Both fold exactly into the decoder's
last AdaIN (`fold`), so that a material's decoder outputs raw values.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import FlashSetup
from matcap.space.decoder import Decoder
from matcap.space.tuning.start import head_start

VARYING = 8  # numbers of a base that differ between materials: 5 means, 3 colour deviations

_CONTRASTS = (0.02, 1.5)  # limits of the deviation of log colour
# Factors on the deviations that a capture starts with; larger for F0 and roughness, whose means
# must be able to change more.
_UNIT = (1.0, 1.0, 1.0, 3.0, 3.0, 1.0)

# Deviations of F0, roughness and height are the same for every photograph.
_ANY = CoarseFit((0.5, 0.5, 0.5), 0.04, 0.5, FlashSetup(), 0.0)


@dataclass(frozen=True)
class Base:
    """Offset and scale of each raw output, (OUTPUTS,) or (B, OUTPUTS) each."""

    mean: Tensor
    deviation: Tensor

    def apply(self, output: Tensor) -> Tensor:
        """Raw values mean + deviation * output, (B, OUTPUTS, H, W)."""
        return self.mean[..., None, None] + self.deviation[..., None, None] * output


def base_of(coarse: CoarseFit, contrast: Tensor) -> Base:
    """The base of a photograph; `contrast` is (3,) from tuning.start.log_contrast."""
    mean, deviation = head_start(coarse, contrast.float().clamp(*_CONTRASTS))
    return Base(mean, deviation * torch.tensor(_UNIT))


def varying(base: Base) -> Tensor:
    """(VARYING,) numbers that differ between bases: means, and logs of colour deviations."""
    return torch.cat([base.mean[:5], base.deviation[:3].log()])


def base_from(numbers: Tensor) -> Base:
    """The inverse of varying()."""
    rest = head_start(_ANY, torch.zeros(3))[1][3:] * torch.tensor(_UNIT[3:])
    low, high = _CONTRASTS
    return Base(
        torch.cat([numbers[:5], torch.zeros(1)]),
        torch.cat([numbers[5:].exp().clamp(low, 1.2 * high), rest]),
    )


def fold(decoder: Decoder, base: Base) -> Decoder:
    """A copy of a decoder with the base folded into its head, so that it outputs raw values."""
    folded = copy.deepcopy(decoder).requires_grad_(True)
    scale = torch.cat([base.deviation, base.deviation])
    shift = torch.cat([base.mean, torch.zeros_like(base.mean)])
    with torch.no_grad():
        affine = folded.head.adain.affine
        affine.weight.mul_(scale[:, None])
        affine.bias.mul_(scale).add_(shift)
    return folded
