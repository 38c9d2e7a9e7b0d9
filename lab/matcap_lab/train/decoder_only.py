"""DECODERONLY, an ablation: a U-Net without its downsampling path (paper, section 5).

Upsampling path and head are the shipped decoder's. The skip connections carry a 1 x 1 convolution
of each level's own white noise, without context from neighbours. The network is not shipped: it
cannot be folded (space/freeze.py) or saved as a material, so `Unfolded` evaluates it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from matcap.brdf.maps import MapSet
from matcap.field.plane import Rectangle
from matcap.space.decoder import (
    ALIGNMENT,
    DEPTH,
    ConvolutionLayer,
    Decoder,
    DecoderConfig,
    LayerStep,
    Moments,
    maps_from_raw,
)
from matcap.space.patch import Patch
from matcap.space.random_field import random_field
from matcap.statistics.lattice import Wave

HALO = 4 * ALIGNMENT  # margin, texels; the upsampling path's receptive field extends over 61


class DecoderOnly(Decoder):
    """A decoder without downsampling path; `config.noise_channels` are those of one level.

    The noise field has these channels for every level. Level k takes every 2^k-th texel of its own
    channels: independent noise of that scale, a function of the texel's position alone.
    """

    def __init__(self, config: DecoderConfig) -> None:
        super().__init__(replace(config, noise_channels=(DEPTH + 1) * config.noise_channels))
        self.down = nn.ModuleList(
            nn.Sequential(ConvolutionLayer(config.noise_channels, width, kernel=1))
            for width in config.widths
        )

    def way_down(
        self, noise: Tensor, step: Callable[[ConvolutionLayer], LayerStep]
    ) -> list[Tensor]:
        """Inputs of the upsampling path, full resolution first: each level's noise."""
        groups = noise.chunk(DEPTH + 1, dim=1)
        return [
            step(layer)(
                group[..., :: 2**level, :: 2**level].contiguous(memory_format=torch.channels_last)
            )
            for level, (group, (layer,)) in enumerate(zip(groups, self.down_layers(), strict=True))
        ]


@dataclass(frozen=True)
class Unfolded:
    """A frozen decoder of any kind as a generator of maps, layer by layer.

    The counterpart of Material for unfolded decoders: endless, and the same texels in every
    rectangle up to rounding of float32.
    """

    decoder: Decoder
    code: Tensor
    moments: tuple[Moments, ...]
    waves: tuple[Wave, ...]
    """As of a Material."""
    texel_size: float
    """A texel's side, plane units."""

    def maps(self, width: int, height: int, *, seed: int = 0, x: int = 0, y: int = 0) -> MapSet:
        """Maps of a rectangle; all four numbers are multiples of ALIGNMENT."""
        field = random_field(
            Patch(seed, Rectangle(x - HALO, y - HALO, width + 2 * HALO, height + 2 * HALO)),
            self.decoder.config.noise_channels,
            self.waves,
            levels=DEPTH,
            cells=self.decoder.config.cells,
        )
        with torch.inference_mode():
            raw = self.decoder(field, self.code, self.moments, periodic=False)[0]
        return maps_from_raw(raw[..., HALO:-HALO, HALO:-HALO], self.texel_size)
