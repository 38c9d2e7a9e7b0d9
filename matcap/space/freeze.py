"""Freezing: AdaIN with stored statistics, folded into the convolutions.

Instance normalisation makes the output depend on the rectangle that is decoded. Statistics that are
measured once on a large reference field and stored turn every AdaIN into an affine map, which folds
into the convolution before it. What remains is a CNN whose output at a texel depends on the noise
around it alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.field.plane import Rectangle, Span
from matcap.space.decoder import (
    DEPTH,
    ConvolutionLayer,
    Decoder,
    DecoderConfig,
    Moments,
    descend,
    upsample,
)
from matcap.space.drawing import Drawing
from matcap.space.layers import convolve
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField, random_field
from matcap.space.spans import Spans
from matcap.statistics.lattice import Wave

_SIZE = 512  # texels a side of the reference field
_REFERENCE_SEED = -1  # a seed that users are unlikely to choose


def reference_field(
    config: DecoderConfig, waves: tuple[Wave, ...], drawing: Drawing | None = None
) -> RandomField:
    """The periodic random field on which statistics are measured."""
    area, period = Rectangle(0, 0, _SIZE, _SIZE), (_SIZE, _SIZE)
    field = random_field(
        Patch(_REFERENCE_SEED, area, period=period),
        config.noise_channels,
        waves,
        levels=DEPTH,
        cells=config.cells,
    )
    if drawing is None:
        return field
    return replace(field, drawing=drawing.levels(_REFERENCE_SEED, area, period))


def freeze(
    decoder: Decoder, code: Tensor, waves: tuple[Wave, ...], drawing: Drawing | None = None
) -> list[Moments]:
    """Statistics of every layer for a latent vector, measured on the reference field."""
    with torch.no_grad():
        field = reference_field(decoder.config, waves, drawing)
        return decoder.reference_moments(field, code)


_Area = tuple[Span, Span]  # rows, columns


@dataclass(frozen=True)
class FoldedLayer:
    """A convolution with its AdaIN folded in."""

    weights: tuple[Tensor, ...]
    """(out, in_i, k, k) for each part of its input, in channels_last memory format. On the way up
    the parts are the level below, the skip connection and, if any, drawing and lattice channels."""
    bias: Tensor
    """(out,) bias of each channel."""
    activate: bool
    """Whether a ReLU follows."""

    def __call__(self, *parts: Tensor) -> Tensor:
        """Apply the layer without padding, in its own precision; see convolve."""
        parts = tuple(part.to(self.bias.dtype) for part in parts)
        return convolve(parts, self.weights, self.bias, activate=self.activate)

    def to(self, target: torch.dtype | torch.device) -> FoldedLayer:
        """A copy of another precision or on another device."""
        weights = tuple(weight.to(target) for weight in self.weights)
        return FoldedLayer(weights, self.bias.to(target), self.activate)


@dataclass(frozen=True)
class FoldedDecoder:
    """A frozen decoder as a CNN from a random field to raw outputs."""

    noise_channels: int
    """Input channels of white noise."""
    cells: int
    """Input channels of cell noise; 0 without a lattice."""
    has_waves: bool
    """Whether it reads lattice channels."""
    down: tuple[tuple[FoldedLayer, ...], ...]
    """Layers by block, full resolution first."""
    up: tuple[tuple[FoldedLayer, ...], ...]
    """Layers by block, coarsest first."""
    head: FoldedLayer

    @property
    def convolutions(self) -> tuple[int, int]:
        """3 x 3 convolutions per block on the way down and on the way up."""
        return len(self.down[0]), len(self.up[0])

    @property
    def device(self) -> torch.device:
        """Device of its weights."""
        return self.head.bias.device

    def to(self, device: torch.device) -> FoldedDecoder:
        """A copy on another device."""
        down, up = (
            tuple(tuple(layer.to(device) for layer in block) for block in blocks)
            for blocks in (self.down, self.up)
        )
        return replace(self, down=down, up=up, head=self.head.to(device))

    def decode(self, field: RandomField, rows: Spans, columns: Spans) -> Tensor:
        """Raw outputs (B, OUTPUTS, H, W) over the spans' output, float32.

        Args:
            field: noise over the spans' down[0], drawing and lattice channels over their joined.
            rows, columns: spans_of for this decoder's convolutions.
        """

        def cut(features: Tensor, wanted: _Area, covered: _Area) -> Tensor:
            """The part of features over `covered` that lies in `wanted`."""
            high, wide = (a.within(b) for a, b in zip(wanted, covered, strict=True))
            return features[..., high, wide].contiguous(memory_format=torch.channels_last)

        waves = field.waves if self.has_waves else ()
        skips = descend(field.noise, self.down)
        features = skips[-1]
        covered = (rows.risen[DEPTH], columns.risen[DEPTH])
        for level, (first, *others) in zip(reversed(range(DEPTH)), self.up, strict=True):
            joined = (rows.joined[level], columns.joined[level])
            below = cut(features, (rows.risen[level + 1], columns.risen[level + 1]), covered)
            skip = cut(skips[level], joined, (rows.skips[level], columns.skips[level]))
            read = [each[level] for each in (field.drawing, waves) if each]
            # The outermost texel of what is upsampled is not valid.
            features = first(upsample(below, periodic=False), skip, *read)
            for layer in others:
                features = layer(features)
            covered = (joined[0].grown(-1 - len(others)), joined[1].grown(-1 - len(others)))
        return self.head(cut(features, (rows.output, columns.output), covered))


def fold(
    decoder: Decoder, code: Tensor, moments: Sequence[Moments], *, has_waves: bool
) -> FoldedDecoder:
    """Fold a decoder's AdaIN into its convolutions.

    Args:
        code: (CODE_SIZE,) latent vector.
        moments: frozen statistics, one a layer.
        has_waves: keep the weights of lattice channels.
    """
    with torch.no_grad():
        remaining = iter(moments)

        def folded(layer: ConvolutionLayer, sizes: Sequence[int] = ()) -> FoldedLayer:
            scale, shift = layer.adain.affine_of(code, next(remaining))
            weight = layer.convolution.weight * scale[:, None, None, None]
            parts = weight.split(list(sizes), dim=1) if sizes else (weight,)
            if sizes and not has_waves:
                parts = parts[:-1]
            weights = (
                part.contiguous(memory_format=torch.channels_last) for part in parts if part.numel()
            )
            return FoldedLayer(tuple(weights), shift, layer.activate)

        down = tuple(tuple(folded(layer) for layer in block) for block in decoder.down_layers())
        up = []
        config, below = decoder.config, decoder.config.widths[-1]
        for skip, block in zip(config.widths[-2::-1], decoder.up_layers(), strict=True):
            first = folded(block[0], (below, skip, config.drawing, config.lattice_channels))
            up.append((first, *(folded(layer) for layer in block[1:])))
            below = skip
        return FoldedDecoder(
            noise_channels=decoder.config.noise_channels,
            cells=decoder.config.cells if has_waves else 0,
            has_waves=has_waves,
            down=down,
            up=tuple(up),
            head=folded(decoder.head),
        )
