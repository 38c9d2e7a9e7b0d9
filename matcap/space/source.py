"""The source of a decoder's field, which computes its blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.stated import NormalStyle
from matcap.field.blocks import RING, Grid
from matcap.field.device import repeatable
from matcap.field.plane import Period, Rectangle, Span
from matcap.field.source import planes_of
from matcap.space.decoder import ALIGNMENT, maps_from_raw
from matcap.space.drawing import Drawing
from matcap.space.freeze import FoldedDecoder
from matcap.space.lattice_channels import lattice_field
from matcap.space.noise import noise_field
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField
from matcap.space.spans import Spans, spans_of
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class BlockSpans:
    """A block, and the spans of every level that decoding it reads."""

    block: Rectangle
    rows: Spans
    columns: Spans

    def rectangle(self, rows: Span, columns: Span, level: int = 0) -> Rectangle:
        """The field's texels that spans of a level cover, in texels of that level."""
        x, y = (self.block.x >> level) + columns.start, (self.block.y >> level) + rows.start
        return Rectangle(x, y, columns.size, rows.size)


def spans_of_block(block: Rectangle, convolutions: tuple[int, int]) -> BlockSpans:
    """Spans for a block and its ring; `convolutions` per block of layers, (down, up)."""
    rows, columns = (
        spans_of(Span(-RING, size + RING), convolutions) for size in (block.height, block.width)
    )
    return BlockSpans(block, rows, columns)


def read_noise(source: DecoderSource, spans: BlockSpans) -> Tensor:
    """(1, noise_channels, H, W) noise of a block's spans."""
    part = spans.rectangle(spans.rows.down[0], spans.columns.down[0])
    patch = Patch(source.seed, part, period=source.period, device=source.device)
    return noise_field(patch, source.decoder.noise_channels)[None]


def read_lattice(source: DecoderSource, spans: BlockSpans) -> tuple[Tensor, ...]:
    """Per level (1, WAVE_CHANNELS + cells, H, W) lattice channels of a block's spans, if any."""
    if not source.waves:
        return ()
    stack = []
    for level, reached in enumerate(zip(spans.rows.joined, spans.columns.joined, strict=True)):
        part = spans.rectangle(*reached, level)
        patch = Patch(source.seed, part, level, source.period, source.device)
        field = lattice_field(patch, source.waves, source.decoder.cells)
        stack.append(field[None].contiguous(memory_format=torch.channels_last))
    return tuple(stack)


def read_drawing(source: DecoderSource, spans: BlockSpans) -> tuple[Tensor, ...]:
    """Per level (1, DRAWING_CHANNELS, H, W) of a block's spans; empty without a drawing."""
    if source.drawing is None:
        return ()
    rows, columns = _reached(spans.rows.joined), _reached(spans.columns.joined)
    levels = source.drawing.levels(source.seed, spans.rectangle(rows, columns), source.period)
    stack = []
    for k, plane in enumerate(levels):
        high, wide = (
            each.within(Span(whole.start >> k, whole.stop >> k))
            for each, whole in ((spans.rows.joined[k], rows), (spans.columns.joined[k], columns))
        )
        part = plane[..., high, wide].to(source.device)
        stack.append(part.contiguous(memory_format=torch.channels_last))
    return tuple(stack)


def _reached(joined: tuple[Span, ...]) -> Span:
    """The span of level 0 that has all levels' texels, those of the coarsest whole."""
    first = min(each.start << level for level, each in enumerate(joined))
    last = max(each.stop << level for level, each in enumerate(joined))
    return Span(first // ALIGNMENT * ALIGNMENT, -(-last // ALIGNMENT) * ALIGNMENT)


@dataclass(frozen=True)
class DecoderSource:
    """The field of one decoder and seed; picklable."""

    decoder: FoldedDecoder
    """The folded decoder, in the precision to compute in."""
    waves: tuple[Wave, ...]
    """Waves of the material's lattice."""
    texel_size: float
    """Side of a texel in plane units."""
    seed: int
    """Seed of the realisation."""
    period: Period | None = None
    """Period in texels, multiples of ALIGNMENT; None if the field never repeats."""
    grid: Grid = Grid()
    drawing: Drawing | None = None
    """The drawing that the decoder reads, or None."""
    turned: bool = False
    """Whether the field is that of the lying photograph, rotated 90 degrees clockwise."""

    @property
    def specular_channels(self) -> int:
        """Channels of F0: 1, as the network's F0 is achromatic."""
        return 1

    @property
    def device(self) -> torch.device:
        """Device that computes it."""
        return self.decoder.device

    @property
    def device_type(self) -> str:
        """Device that computes it: "cpu" or "cuda"."""
        return self.device.type

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (OUTPUTS, height + 2 RING, width + 2 RING) of a block and its ring."""
        if self.turned:
            return self._lying().maps(_lying(block)).rot90(-1, (1, 2)).contiguous()
        spans = spans_of_block(block, self.decoder.convolutions)
        with torch.inference_mode(), repeatable(self.device):
            noise, lattice = read_noise(self, spans), read_lattice(self, spans)
            field = RandomField(noise, lattice, read_drawing(self, spans))
            raw = self.decoder.decode(field, spans.rows, spans.columns)[0].contiguous()
            # Vectorised sigmoids round the last few texels of a row differently. They must see
            # whole blocks, so that a texel has the same bits whatever rectangle is read.
            return maps_from_raw(raw, self.texel_size).stacked()

    def _lying(self) -> DecoderSource:
        period = self.period and (self.period[1], self.period[0])
        return replace(self, turned=False, period=period)

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9, height, width) maps and normal of a block."""
        return planes_of(self, block, normal)


def _lying(block: Rectangle) -> Rectangle:
    """A block's texels before it was rotated 90 degrees clockwise about the origin."""
    return Rectangle(block.y, -block.x - block.width, block.height, block.width)
