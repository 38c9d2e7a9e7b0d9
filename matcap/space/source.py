"""A block of a decoder's field: what a worker needs, and all it needs, to compute any block."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.stated import NormalStyle
from matcap.field.blocks import RING, Grid
from matcap.field.device import repeatable
from matcap.field.plane import Period, Rectangle, Span
from matcap.field.source import planes_of
from matcap.space.decoder import maps_from_raw
from matcap.space.freeze import FoldedDecoder
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField, noise_of
from matcap.space.regular_order import order_field
from matcap.space.spans import Spans, spans_of
from matcap.statistics.lattice import Wave


class Seeded(Protocol):
    """Which random field."""

    @property
    def seed(self) -> int:
        """The realisation."""
        ...

    @property
    def period(self) -> Period | None:
        """What repeats."""
        ...

    @property
    def device(self) -> torch.device:
        """Where it is computed."""
        ...


@dataclass(frozen=True)
class BlockSpans:
    """What decoding a block reads: the block, and rows and columns of every level around it."""

    block: Rectangle
    rows: Spans
    columns: Spans


def spans_of_block(block: Rectangle, convolutions: tuple[int, int]) -> BlockSpans:
    """The spans that decoding a block and its ring reads, for a decoder of so many convolutions."""
    rows, columns = (
        spans_of(Span(-RING, size + RING), convolutions) for size in (block.height, block.width)
    )
    return BlockSpans(block, rows, columns)


def read_noise(source: Seeded, spans: BlockSpans, white: int, grains: int = 0) -> Tensor:
    """(1, channels, H, W) noise of a block's spans."""
    columns, rows = spans.columns.down[0], spans.rows.down[0]
    x, y = spans.block.x + columns.start, spans.block.y + rows.start
    part = Rectangle(x, y, columns.size, rows.size)
    patch = Patch(source.seed, part, period=source.period, device=source.device)
    return noise_of(patch, white, grains)[None]


def read_order(
    source: Seeded, spans: BlockSpans, waves: tuple[Wave, ...], cells: int
) -> tuple[Tensor, ...]:
    """Per level (1, WAVE_CHANNELS + cells, H, W) order of a block's spans; none of no waves."""
    if not waves:
        return ()
    stack = []
    for level, (columns, rows) in enumerate(
        zip(spans.columns.joined, spans.rows.joined, strict=True)
    ):
        x, y = (spans.block.x >> level) + columns.start, (spans.block.y >> level) + rows.start
        part = Rectangle(x, y, columns.size, rows.size)
        patch = Patch(source.seed, part, level, source.period, source.device)
        field = order_field(patch, waves, cells)
        stack.append(field[None].contiguous(memory_format=torch.channels_last))
    return tuple(stack)


@dataclass(frozen=True)
class DecoderSource:
    """The field of one decoder and seed; picklable."""

    decoder: FoldedDecoder
    """Folded, in the precision to compute in."""
    waves: tuple[Wave, ...]
    """Of the material's regular order."""
    texel_size: float
    """In plane units."""
    seed: int
    """Which realisation."""
    period: Period | None = None
    """What repeats, in multiples of ALIGNMENT."""
    grid: Grid = Grid()
    """The blocks that the plane is cut into."""

    @property
    def specular_channels(self) -> int:
        """Of F0: its network knows no colour of it."""
        return 1

    @property
    def device(self) -> torch.device:
        """Where it is computed."""
        return self.decoder.device

    @property
    def device_type(self) -> str:
        """Where it is computed."""
        return self.device.type

    def lowered(self, finest: int) -> DecoderSource:
        """The same in bfloat16 from level `finest` on to the coarser ones."""
        return replace(self, decoder=self.decoder.lowered(finest))

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (OUTPUTS, height + 2 RING, width + 2 RING) of a block and its ring."""
        spans = spans_of_block(block, self.decoder.convolutions)
        with torch.inference_mode(), repeatable(self.device):
            field = RandomField(
                read_noise(self, spans, self.decoder.noise_channels, self.decoder.grains),
                read_order(self, spans, self.waves, self.decoder.cells),
            )
            raw = self.decoder.decode(field, spans.rows, spans.columns)[0].contiguous()
            # Before anything is cut off: a vectorised sigmoid rounds a row's last few texels
            # differently, so it must see the same rows whatever rectangle is asked for.
            return maps_from_raw(raw, self.texel_size).stacked()

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9, height, width) of a block: the six maps and the normal."""
        return planes_of(self, block, normal)
