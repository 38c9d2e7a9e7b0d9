"""Freezing: AdaIN's statistics measured once, so that a material becomes a plain network on noise.

Instance normalisation makes an output depend on the rectangle that was decoded. Measured over a
large reference field instead and stored, the statistics turn every AdaIN into an affine map,
which folds into the convolution before it: what is left is convolutions, ReLUs, poolings and
upsamplings, the same for every rectangle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.field.plane import Rectangle, Span
from matcap.space.convolve import CHANNELS_LAST, Steps
from matcap.space.decoder import (
    DEPTH,
    ConvolutionLayer,
    Decoder,
    DecoderConfig,
    LayerStep,
    Moments,
    unet,
)
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField, random_field
from matcap.space.spans import Spans
from matcap.statistics.lattice import Wave

REFERENCE_SIZE = 512  # texels a side of the reference field
_REFERENCE_SEED = -1  # a field of its own, which no user's seed is likely to ask for


def reference_field(
    config: DecoderConfig, waves: tuple[Wave, ...], size: int = REFERENCE_SIZE
) -> RandomField:
    """The periodic field on which statistics are frozen."""
    return random_field(
        Patch(_REFERENCE_SEED, Rectangle(0, 0, size, size), period=(size, size)),
        config.noise_channels,
        waves,
        levels=DEPTH,
        cells=config.cells,
        grains=config.grains,
    )


def freeze(decoder: Decoder, code: Tensor, waves: tuple[Wave, ...]) -> list[Moments]:
    """Statistics of every layer for a code, measured layer by layer on the reference field."""
    with torch.no_grad():
        field = reference_field(decoder.config, waves)
        return decoder.reference_moments(field, code)


_Area = tuple[Span, Span]  # rows, columns


@dataclass(frozen=True)
class FoldedLayer:
    """A convolution with its AdaIN folded in."""

    weights: tuple[Tensor, ...]
    """(out, in_i, k, k) for each part of what it reads, channels last in memory: on the way up that
    is the level below, the skip connection and, if any, the waves."""
    bias: Tensor
    """(out,)."""
    activate: bool
    """Followed by ReLU."""

    def __call__(self, features: Tensor) -> Tensor:
        """The step on all parts laid side by side; borders are padded with zeros."""
        weight = torch.cat(self.weights, dim=1)
        features = F.conv2d(features, weight, self.bias, padding=weight.shape[-1] // 2)
        return features.relu_() if self.activate else features

    def valid(self, steps: Steps, *parts: Tensor) -> Tensor:
        """The step on its parts, only where the kernel lies inside, in its own precision."""
        parts = tuple(part.to(self.bias.dtype) for part in parts)
        return steps.convolve(parts, self.weights, self.bias, activate=self.activate)

    def to(self, target: torch.dtype | torch.device) -> FoldedLayer:
        """In another precision or on another device."""
        weights = tuple(weight.to(target) for weight in self.weights)
        return FoldedLayer(weights, self.bias.to(target), self.activate)


@dataclass(frozen=True)
class FoldedDecoder:
    """A frozen decoder: noise in, raw outputs out, the same numbers wherever it is asked."""

    noise_channels: int
    """Of white noise that it reads."""
    grains: int
    """Channels of structured noise that it reads."""
    cells: int
    """Channels of the noise of cells; 0 without waves."""
    has_waves: bool
    """Whether it reads the order of regular_order.py."""
    down: tuple[tuple[FoldedLayer, ...], ...]
    up: tuple[tuple[FoldedLayer, ...], ...]
    head: FoldedLayer
    """Its layers, block by block."""

    def __call__(self, field: RandomField) -> Tensor:
        """Raw outputs (B, OUTPUTS, H, W) of a whole field; a halo at every border is not valid.

        The plain form, which `decode` is tested against.
        """
        if not self.has_waves:
            field = RandomField(field.noise, ())
        down: Sequence[Sequence[LayerStep]] = self.down
        up: Sequence[Sequence[LayerStep]] = self.up
        return unet(field, down, up, self.head, periodic=False)

    @property
    def convolutions(self) -> tuple[int, int]:
        """3 x 3 convolutions per block on the way down and on the way up."""
        return len(self.down[0]), len(self.up[0])

    @property
    def device(self) -> torch.device:
        """Where it computes."""
        return self.head.bias.device

    def to(self, device: torch.device) -> FoldedDecoder:
        """On another device."""
        down = tuple(tuple(layer.to(device) for layer in block) for block in self.down)
        up = tuple(tuple(layer.to(device) for layer in block) for block in self.up)
        return replace(self, down=down, up=up, head=self.head.to(device))

    def lowered(self, finest: int = 0) -> FoldedDecoder:
        """In bfloat16 from level `finest` on to the coarser ones; never the head.

        The head's few multiplications state the maps, which bfloat16's eight bits could not.
        """

        def lower(level: int, block: tuple[FoldedLayer, ...]) -> tuple[FoldedLayer, ...]:
            return tuple(layer.to(torch.bfloat16) for layer in block) if level >= finest else block

        down = tuple(lower(level, block) for level, block in enumerate(self.down))
        up = tuple(lower(DEPTH - 1 - index, block) for index, block in enumerate(self.up))
        return replace(self, down=down, up=up)

    def decode(self, field: RandomField, rows: Spans, columns: Spans) -> Tensor:
        """Raw outputs (B, OUTPUTS, H, W) over the spans' output, float32, all of them valid.

        Args:
            field: noise over the spans' down[0] and, if there are any, waves over their joined.
            rows, columns: of this decoder's convolutions.
        """
        steps = CHANNELS_LAST

        def cut(features: Tensor, wanted: _Area, covered: _Area) -> Tensor:
            """The part of features over `covered` that lies in `wanted`."""
            high, wide = (a.within(b) for a, b in zip(wanted, covered, strict=True))
            return steps.lay(features[..., high, wide])

        features, skips = field.noise, []
        for level, block in enumerate(self.down):
            if level > 0:
                features = steps.halve(features)
            for layer in block:
                features = layer.valid(steps, features)
            skips.append(features)
        covered = (rows.risen[DEPTH], columns.risen[DEPTH])
        for level, (first, *others) in zip(reversed(range(DEPTH)), self.up, strict=True):
            joined = (rows.joined[level], columns.joined[level])
            below = cut(features, (rows.risen[level + 1], columns.risen[level + 1]), covered)
            skip = cut(skips[level], joined, (rows.skips[level], columns.skips[level]))
            waves = [field.waves[level]] if self.has_waves else []
            features = first.valid(steps, double(below), skip, *waves)
            for layer in others:
                features = layer.valid(steps, features)
            covered = (joined[0].grown(-1 - len(others)), joined[1].grown(-1 - len(others)))
        return self.head.valid(steps, cut(features, (rows.output, columns.output), covered))


def double(features: Tensor) -> Tensor:
    """Twice the size, bilinear; the outermost texel is not valid."""
    return F.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)


def fold(
    decoder: Decoder, code: Tensor, moments: Sequence[Moments], *, has_waves: bool
) -> FoldedDecoder:
    """The frozen decoder of one material. Without waves their weights are dropped."""
    with torch.no_grad():
        remaining = iter(moments)

        def folded(layer: ConvolutionLayer, sizes: Sequence[int] = ()) -> FoldedLayer:
            scale, shift = layer.adain.affine_of(code, next(remaining))
            weight = layer.convolution.weight * scale[:, None, None, None]
            parts = weight.split(list(sizes), dim=1) if sizes else (weight,)
            if sizes and not has_waves:
                parts = parts[:-1]
            weights = (part.contiguous(memory_format=torch.channels_last) for part in parts)
            return FoldedLayer(tuple(weights), shift, layer.activate)

        down = tuple(tuple(folded(layer) for layer in block) for block in decoder.down_layers())
        up = []
        below = decoder.config.widths[-1]
        for skip, block in zip(decoder.config.widths[-2::-1], decoder.up_layers(), strict=True):
            first = folded(block[0], (below, skip, decoder.config.order_channels))
            up.append((first, *(folded(layer) for layer in block[1:])))
            below = skip
        return FoldedDecoder(
            noise_channels=decoder.config.noise_channels,
            grains=decoder.config.grains,
            cells=decoder.config.cells if has_waves else 0,
            has_waves=has_waves,
            down=down,
            up=tuple(up),
            head=folded(decoder.head),
        )
