"""Freezing: AdaIN with stored statistics; spans of the levels, and the drawing a decoder reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.example.example import Example
from matcap.example.exemplar import COLOURED, DIFFUSE, HEIGHT, SPECULAR
from matcap.field.plane import Period, Rectangle, Span
from matcap.files.color import LUMINANCE
from matcap.space.decoder import (
    DEPTH,
    ConvolutionLayer,
    Decoder,
    DecoderConfig,
    Moments,
    convolve,
    descend,
    upsample,
)
from matcap.space.random_field import Patch, RandomField, random_field
from matcap.statistics.lattice import Wave

# The drawing that a decoder reads besides noise: log luminance and relief of an endless field.
#
# The default generator rearranges the exemplar for every seed; the decoder turns this field's
# drawing into maps. Channels are standardised by the exemplar:
#
# log(Y),    h - mean of h over a square of 2 AROUND + 1 texels,
#
# with Y the luminance of diffuse albedo (where F0 has a colour, of their sum) and h the height in
# texels. Level k has means of 2^k x 2^k texels. Statistics alone close no cell of leather, however
# well they are matched (docs/notes/prior.md).

AROUND = 16  # texels; slower relief is no pattern
_DARKEST = 1e-3  # least luminance
_FLAT = 1e-4  # least deviation that is standardised


@dataclass(frozen=True)
class Drawing:
    """The drawing of an example's field, at every seed; picklable."""

    example: Example
    finer: int = 1
    """Texels of the example along one of the drawing, which has means of them."""
    turned: bool = False
    """Whether the example is upright, 90 degrees clockwise, and the drawing lies."""

    @property
    def alignment(self) -> int:
        """Texels: periods of its field are multiples of this."""
        return max(1, self.example.alignment // self.finer)

    @property
    def texel_size(self) -> float:
        """Side of a texel of the drawing, plane units."""
        return self.finer * self.example.exemplar.texel_size

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the exemplar in texels of the drawing."""
        width, height = (side // self.finer for side in self.example.exemplar.size)
        return (height, width) if self.turned else (width, height)

    def levels(
        self, seed: int, area: Rectangle, period: Period | None = None
    ) -> tuple[Tensor, ...]:
        """(1, DRAWING_CHANNELS, height / 2^k, width / 2^k) of each level k on the way up.

        Args:
            seed: of the realisation.
            area: whose corner and sides are multiples of 2^(DEPTH - 1) texels.
            period: of the field, or None.
        """
        return self.levels_of(self.around(seed, area, period))

    def around(self, seed: int, area: Rectangle, period: Period | None = None) -> Tensor:
        """Stacked maps of the field over an area and what levels_of() needs around it."""
        read, along = area.grown(AROUND), period or (None, None)
        if self.turned:
            read = Rectangle(read.y, read.x, read.height, read.width)
            read, along = replace(read, x=-read.x - read.width), along[::-1]
        x, y, width, height = (self.finer * n for n in (read.x, read.y, read.width, read.height))
        finer = tuple(length and self.finer * length for length in along)
        maps = self.example.maps(
            seed, Rectangle(x, y, width, height), (finer[0], finer[1]) if period else None
        )
        coarse = self._coarser(torch.from_numpy(maps))
        return coarse.rot90(1, (1, 2)).contiguous() if self.turned else coarse

    def _coarser(self, maps: Tensor) -> Tensor:
        return F.avg_pool2d(maps, self.finer) if self.finer > 1 else maps

    def levels_of(self, maps: Tensor) -> tuple[Tensor, ...]:
        """The drawing of stacked maps (6 or 8, H + 2 AROUND, W + 2 AROUND); see levels()."""
        mean, deviation = self._moments
        levels = [((self._planes(maps) - mean) / deviation)[None]]
        for _ in range(DEPTH - 1):
            levels.append(F.avg_pool2d(levels[-1], 2))
        return tuple(levels)

    @cached_property
    def _moments(self) -> tuple[Tensor, Tensor]:
        """(DRAWING_CHANNELS, 1, 1) mean and deviation over the exemplar."""
        maps = self._coarser(torch.from_numpy(self.example.exemplar.stacked()))[None]
        planes = self._planes(F.pad(maps, (AROUND,) * 4, mode="replicate")[0])
        mean, deviation = planes.mean((1, 2), keepdim=True), planes.std((1, 2), keepdim=True)
        return mean, deviation.clamp_min(_FLAT)

    def _planes(self, maps: Tensor) -> Tensor:
        """The drawing before it is standardised, (DRAWING_CHANNELS, H, W)."""
        colour = maps[DIFFUSE]
        if len(maps[SPECULAR]) == COLOURED:
            colour = colour + maps[SPECULAR]
        luminance = torch.tensordot(colour.new_tensor(LUMINANCE), colour, 1)
        height, side = maps[HEIGHT] / self.texel_size, 2 * AROUND + 1
        mean = F.avg_pool2d(F.avg_pool2d(height, (side, 1), 1), (1, side), 1)
        within = (..., slice(AROUND, -AROUND), slice(AROUND, -AROUND))
        drawn = luminance.clamp_min(_DARKEST).log()[None]
        return torch.cat([drawn[within], height[within] - mean])


# Receptive fields: the span of every decoder level that a block of output needs.
#
# Computed from the output back to the noise, so that convolutions need no padding. Spans are along
# one axis, in texels of their level, counted from the block's first texel.


@dataclass(frozen=True)
class Spans:
    """Spans of every level along one axis, full resolution first."""

    output: Span
    """Span of the raw outputs."""
    joined: tuple[Span, ...]
    """Span of the input of each upward block (the level below upsampled, skip connection, lattice),
    for levels 0 to DEPTH - 1. The outermost upsampled texel is not valid."""
    risen: tuple[Span, ...]
    """Span of each level that is upsampled, for levels 1 to DEPTH; entry 0 is the output."""
    down: tuple[Span, ...]
    """Span of the input of each downward block; entry 0 is the noise."""
    skips: tuple[Span, ...]
    """Span of the output of each downward block, which the skip connection takes."""


def spans_of(output: Span, convolutions: tuple[int, int]) -> Spans:
    """Spans for an output; `convolutions` are 3 x 3 ones per block on the way down and up."""
    down_count, up_count = convolutions
    risen, joined = [output], []
    for _ in range(DEPTH):
        valid = risen[-1].grown(up_count)
        # Upsampled texel i is interpolated from texels (i - 1) // 2 and (i + 1) // 2.
        risen.append(Span((valid.start - 1) // 2, valid.stop // 2 + 1))
        joined.append(risen[-1].doubled())
    skips = [risen[-1]]
    down = [skips[-1].grown(down_count)]
    for _ in range(DEPTH):
        skips.append(down[-1].doubled())
        down.append(skips[-1].grown(down_count))
    return Spans(output, tuple(joined), tuple(risen), tuple(down[::-1]), tuple(skips[::-1]))


# Freezing: AdaIN with stored statistics, folded into the convolutions.
#
# Instance normalisation makes the output depend on the rectangle that is decoded. Statistics that
# are measured once on a large reference field and stored turn every AdaIN into an affine map, which
# folds into the convolution before it. What remains is a CNN whose output at a texel depends on the
# noise around it alone.

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
