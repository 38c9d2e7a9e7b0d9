"""Freezing: AdaIN's statistics measured once, so that a material becomes a plain network on noise.

Instance normalisation makes an output depend on the rectangle that was decoded. Measured over a
large reference field instead and stored, the statistics turn every AdaIN into an affine map,
which folds into the convolution before it: what is left is convolutions, ReLUs, poolings and
upsamplings, the same for every rectangle (DESIGN, section 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.model.decoder import DEPTH, Decoder, Layer, Moments, Step, unet
from matcap.model.noise import WAVE_CHANNELS, RandomField, Wave, random_field

REFERENCE_SIZE = 512  # texels a side of the reference field
_REFERENCE_SEED = -1  # a field of its own, which no user's seed is likely to ask for


def reference_field(
    noise_channels: int, waves: tuple[Wave, ...], size: int = REFERENCE_SIZE
) -> RandomField:
    """The periodic field on which statistics are frozen."""
    return random_field(
        _REFERENCE_SEED, noise_channels, waves, 0, 0, size, size, levels=DEPTH, period=(size, size)
    )


def freeze(decoder: Decoder, code: Tensor, waves: tuple[Wave, ...]) -> list[Moments]:
    """Statistics of every layer for a code, measured layer by layer on the reference field."""
    with torch.no_grad():
        field = reference_field(decoder.config.noise_channels, waves)
        return decoder.reference_moments(field, code)


@dataclass(frozen=True)
class FoldedLayer:
    """A convolution with its AdaIN folded in.

    Attributes:
        weight: (out, in, k, k), channels last in memory.
        bias: (out,).
        activate: followed by ReLU.
    """

    weight: Tensor
    bias: Tensor
    activate: bool

    def __call__(self, features: Tensor) -> Tensor:
        """The step; borders are padded with zeros, which a halo cuts off later."""
        padding = self.weight.shape[-1] // 2
        features = F.conv2d(features, self.weight, self.bias, padding=padding)
        return features.relu_() if self.activate else features


@dataclass(frozen=True)
class FoldedDecoder:
    """A frozen decoder: noise in, raw outputs out, the same numbers wherever it is asked."""

    noise_channels: int
    has_waves: bool
    down: tuple[tuple[FoldedLayer, ...], ...]
    up: tuple[tuple[FoldedLayer, ...], ...]
    head: FoldedLayer

    def __call__(self, field: RandomField) -> Tensor:
        """Raw outputs (B, OUTPUTS, H, W); a halo's width at every border is not valid."""
        if not self.has_waves:
            field = RandomField(field.noise, ())
        down: Sequence[Sequence[Step]] = self.down
        up: Sequence[Sequence[Step]] = self.up
        return unet(field, down, up, self.head, periodic=False)


def fold(
    decoder: Decoder, code: Tensor, moments: Sequence[Moments], *, has_waves: bool
) -> FoldedDecoder:
    """The frozen decoder of one material. Without waves their weights are dropped."""
    with torch.no_grad():
        remaining = iter(moments)

        def folded(layer: Layer) -> FoldedLayer:
            scale, shift = layer.adain.affine_of(code, next(remaining))
            weight = layer.convolution.weight * scale[:, None, None, None]
            return FoldedLayer(
                weight.contiguous(memory_format=torch.channels_last), shift, layer.activate
            )

        down = tuple(tuple(folded(layer) for layer in block) for block in decoder.down_layers())
        up = []
        for block in decoder.up_layers():
            layers = [folded(layer) for layer in block]
            if not has_waves:
                first = layers[0]
                weight = first.weight[:, :-WAVE_CHANNELS].contiguous(
                    memory_format=torch.channels_last
                )
                layers[0] = FoldedLayer(weight, first.bias, first.activate)
            up.append(tuple(layers))
        return FoldedDecoder(
            decoder.config.noise_channels, has_waves, down, tuple(up), folded(decoder.head)
        )
