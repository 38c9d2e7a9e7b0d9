"""A block of one material's field: what a worker needs, and all it needs, to compute any block."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from matcap.errors import UsageError
from matcap.model.blocks import Grid
from matcap.model.decoder import ALIGNMENT, maps_from_raw
from matcap.model.device import repeatable
from matcap.model.freeze import FoldedDecoder
from matcap.model.noise import SEED_LIMIT, noise_field
from matcap.model.order import order_field
from matcap.model.patch import Patch, Period, Rectangle
from matcap.model.random_field import RandomField
from matcap.model.spans import Span, Spans, spans_of
from matcap.statistics.lattice import Wave

RING = 1  # texels around a block that its normals look at
_CPU = torch.device("cpu")


class Source(Protocol):
    """Anything that blocks can be read from."""

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        ...

    @property
    def grid(self) -> Grid:
        """The blocks that the plane is cut into."""
        ...

    @property
    def period(self) -> Period | None:
        """What repeats."""
        ...

    @property
    def device(self) -> torch.device:
        """Where it is computed."""
        ...

    def lowered(self, finest: int) -> Source:
        """The same in bfloat16 from level `finest` on to the coarser ones."""
        ...

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (OUTPUTS, height + 2 RING, width + 2 RING) of a block and its ring."""
        ...


class Generator(Protocol):
    """What a field is made from: a material."""

    @property
    def waves(self) -> tuple[Wave, ...]:
        """Of its regular order."""
        ...

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        ...

    def folded(self) -> FoldedDecoder:
        """The frozen network."""
        ...


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
class Area:
    """What decoding a block reads."""

    block: Rectangle
    rows: Spans
    columns: Spans


def area_of(block: Rectangle, convolutions: tuple[int, int]) -> Area:
    """The area of a block and its ring, for a decoder of so many convolutions."""
    rows, columns = (
        spans_of(Span(-RING, size + RING), convolutions) for size in (block.height, block.width)
    )
    return Area(block, rows, columns)


def read_noise(source: Seeded, area: Area, channels: int) -> Tensor:
    """(1, channels, H, W) noise of an area."""
    columns, rows = area.columns.down[0], area.rows.down[0]
    x, y = area.block.x + columns.start, area.block.y + rows.start
    part = Rectangle(x, y, columns.size, rows.size)
    patch = Patch(source.seed, part, period=source.period, device=source.device)
    return noise_field(patch, channels)[None]


def read_order(
    source: Seeded, area: Area, waves: tuple[Wave, ...], cells: int
) -> tuple[Tensor, ...]:
    """Per level (1, WAVE_CHANNELS + cells, H, W) order of an area; none of no waves."""
    if not waves:
        return ()
    stack = []
    for level, (columns, rows) in enumerate(
        zip(area.columns.joined, area.rows.joined, strict=True)
    ):
        x, y = (area.block.x >> level) + columns.start, (area.block.y >> level) + rows.start
        part = Rectangle(x, y, columns.size, rows.size)
        patch = Patch(source.seed, part, level, source.period, source.device)
        field = order_field(patch, waves, cells)
        stack.append(field[None].contiguous(memory_format=torch.channels_last))
    return tuple(stack)


@dataclass(frozen=True)
class MaterialSource:
    """The field of one material and seed; picklable.

    Attributes:
        decoder: folded, in the precision to compute in.
        waves: of the material's regular order.
        texel_size: in plane units.
        seed: which realisation.
        period: what repeats, in multiples of ALIGNMENT.
        grid: the blocks that the plane is cut into.
    """

    decoder: FoldedDecoder
    waves: tuple[Wave, ...]
    texel_size: float
    seed: int
    period: Period | None = None
    grid: Grid = Grid()

    @property
    def device(self) -> torch.device:
        """Where it is computed."""
        return self.decoder.device

    def lowered(self, finest: int) -> MaterialSource:
        """The same in bfloat16 from level `finest` on to the coarser ones."""
        return replace(self, decoder=self.decoder.lowered(finest))

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (OUTPUTS, height + 2 RING, width + 2 RING) of a block and its ring."""
        area = area_of(block, self.decoder.convolutions)
        with torch.inference_mode(), repeatable(self.device):
            field = RandomField(
                read_noise(self, area, self.decoder.noise_channels),
                read_order(self, area, self.waves, self.decoder.cells),
            )
            raw = self.decoder.decode(field, area.rows, area.columns)[0].contiguous()
            # Before anything is cut off: a vectorised sigmoid rounds a row's last few texels
            # differently, so it must see the same rows whatever rectangle is asked for.
            return maps_from_raw(raw, self.texel_size).stacked()


def material_source(
    material: Generator, seed: int, period: Period | None = None, device: torch.device = _CPU
) -> MaterialSource:
    """The source of a material's field, computed on a device.

    Raises:
        UsageError: a seed or period out of range.
    """
    check_seed(seed)
    check_period(period)
    decoder = material.folded().to(device)
    return MaterialSource(decoder, material.waves, material.texel_size, seed, period)


def check_seed(seed: int) -> int:
    """The seed, or a UsageError when it is out of range."""
    if not -SEED_LIMIT <= seed < SEED_LIMIT:
        raise UsageError(f"the seed {seed} is out of range", remedy="give one in [-2^63, 2^63)")
    return seed


def check_period(period: Period | None) -> Period | None:
    """The period, or a UsageError when an axis is no positive multiple of ALIGNMENT."""
    for length in period or ():
        if length is not None and (length <= 0 or length % ALIGNMENT):
            raise UsageError(
                f"the period {length} is not a positive multiple of {ALIGNMENT}",
                remedy=f"round it to a multiple of {ALIGNMENT}",
            )
    return period
