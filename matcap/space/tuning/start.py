"""Where fine-tuning starts when there is no prior: a random decoder around the coarse fit.

The coarse fit says what the material is on average and the photograph how strong its texture is.
The decoder's last AdaIN states both outright, so they are put there: mean maps from the fit,
contrast of the diffuse albedo from the photograph, hardly any relief. Colour explains first, and
relief takes over what colour cannot: what turns with the direction to the flash. Starting with
relief instead ends with dark spots dug as rough pits (docs/notes/prior.md).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from matcap.flash.coarse import CoarseFit
from matcap.space.decoder import Decoder, DecoderConfig, with_cells
from matcap.space.regular_order import CELL_CHANNELS
from matcap.space.tuning.tuned import HEAD
from matcap.statistics.encoding import shading


def head_start(coarse: CoarseFit, contrast: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and deviation (6,) of the raw outputs that a fit and a contrast ask for.

    Args:
        coarse: the uniform material.
        contrast: (3,) standard deviation of the photograph's log colour; see log_contrast.
    """
    return (
        torch.cat([coarse.logits(), torch.zeros(1)]),
        torch.cat(
            [
                contrast * HEAD.contrast_gain,
                torch.tensor([HEAD.specular_contrast, HEAD.roughness_contrast, HEAD.relief]),
            ]
        ),
    )


def log_contrast(linear: Tensor, valid: Tensor) -> Tensor:
    """(3,) standard deviation of the log radiance of (3, H, W), shading taken off."""
    toe = 0.01 * float(linear.median()) + 1e-6
    log = torch.log(linear.clamp(0.0, 1.0) + toe)
    texture = log - shading(log[None])[0]
    texture = texture[:, valid] if bool(valid.any()) else texture.flatten(1)
    return texture.std(dim=1, correction=0).clamp(0.02, 1.5)


def untrained(
    config: DecoderConfig,
    coarse: CoarseFit,
    contrast: Tensor,
    seed: int,
    kind: type[Decoder] = Decoder,
) -> Decoder:
    """A random decoder of a kind whose mean maps are the coarse fit's; its code is zero."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        decoder = kind(config)
    with torch.no_grad():
        affine = decoder.head.adain.affine
        affine.weight.zero_()
        affine.bias.copy_(torch.cat(head_start(coarse, contrast)))
    return decoder


def reading_cells(decoder: Decoder, seed: int) -> Decoder:
    """A decoder that reads the noise of cells, too, by random weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        fresh = Decoder(replace(decoder.config, cells=CELL_CHANNELS))
    return with_cells(decoder, fresh)
