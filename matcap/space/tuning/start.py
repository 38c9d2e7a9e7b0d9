"""Random decoder that fine-tuning starts from without a prior.

The last AdaIN is set to the coarse fit's mean maps, the photograph's contrast of the diffuse
albedo, and little relief. Fine-tuning then explains texture by albedo first, and by relief what
depends on the direction to the flash. With more initial relief dark spots end as pits
(docs/notes/prior.md).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from matcap.flash.coarse.fit import CoarseFit
from matcap.space.decoder import Decoder, DecoderConfig, with_cells
from matcap.space.lattice_channels import CELL_CHANNELS
from matcap.statistics.encoding import shading

# The head's first parameters; docs/notes/prior.md.
_CONTRAST_GAIN = 1.2  # logits of diffuse albedo per log radiance: d log sigmoid(x) / dx is below 1
_SPECULAR_CONTRAST = 0.1  # initial standard deviation of the logit of F0
_ROUGHNESS_CONTRAST = 0.1  # initial standard deviation of the logit of roughness
_RELIEF = 0.15  # initial standard deviation of height, texels


def head_start(coarse: CoarseFit, contrast: Tensor) -> tuple[Tensor, Tensor]:
    """Initial mean and deviation (6,) of the raw outputs.

    Args:
        coarse: the uniform material.
        contrast: (3,) standard deviation of the photograph's log colour; see log_contrast.
    """
    return (
        torch.cat([coarse.logits(), torch.zeros(1)]),
        torch.cat(
            [
                contrast * _CONTRAST_GAIN,
                torch.tensor([_SPECULAR_CONTRAST, _ROUGHNESS_CONTRAST, _RELIEF]),
            ]
        ),
    )


def log_contrast(linear: Tensor, valid: Tensor) -> Tensor:
    """(3,) standard deviation of log radiance less its shading, over valid texels.

    Args:
        linear: (3, H, W) radiance.
        valid: (H, W) bool; all texels are used where none is valid.
    """
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
) -> Decoder:
    """A random decoder with the mean maps of a coarse fit; for the latent vector zero.

    Args:
        contrast: (3,) from log_contrast.
        seed: of the weights.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        decoder = Decoder(config)
    with torch.no_grad():
        affine = decoder.head.adain.affine
        affine.weight.zero_()
        affine.bias.copy_(torch.cat(head_start(coarse, contrast)))
    return decoder


def reading_cells(decoder: Decoder, seed: int) -> Decoder:
    """Add cell channels to a decoder, with random weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        fresh = Decoder(replace(decoder.config, cells=CELL_CHANNELS))
    return with_cells(decoder, fresh)
