"""A block of one material's field: what a worker needs, and all it needs, to compute any block."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.folder import NormalStyle
from matcap.brdf.normals import normals_from_slopes
from matcap.errors import UsageError
from matcap.model.blocks import RING, Grid
from matcap.model.decoder import ALIGNMENT, maps_from_raw
from matcap.model.device import repeatable
from matcap.model.example.example import Example
from matcap.model.example.source import ExampleSource, example_source
from matcap.model.freeze import FoldedDecoder
from matcap.model.patch import Patch
from matcap.model.plane import Period, Rectangle, check_period, check_seed
from matcap.model.random_field import RandomField, noise_of
from matcap.model.regular_order import order_field
from matcap.model.spans import Span, Spans, spans_of
from matcap.statistics.lattice import Wave

# How a field is made: by rearranging the exemplar, or by the network.
Generator = Literal["example", "decoder"]
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
    def device_type(self) -> str:
        """Where it is computed: "cpu" or "cuda"."""
        ...

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (OUTPUTS, height + 2 RING, width + 2 RING) of a block and its ring."""
        ...

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9, height, width) of a block: the six maps and the normal."""
        ...


class Network(Source, Protocol):
    """A source that a network computes, in a precision that can be chosen."""

    @property
    def device(self) -> torch.device:
        """Where it is computed."""
        ...

    def lowered(self, finest: int) -> Network:
        """The same in bfloat16 from level `finest` on to the coarser ones."""
        ...


class MaterialLike(Protocol):
    """What a field is made from: see material.py, which reads this module."""

    @property
    def waves(self) -> tuple[Wave, ...]:
        """Of its regular order."""
        ...

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        ...

    @property
    def example(self) -> Example | None:
        """The exemplar, indexed, where there is one."""
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

    @property
    def device_type(self) -> str:
        """Where it is computed."""
        return self.device.type

    def lowered(self, finest: int) -> MaterialSource:
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


def planes_of(source: Source, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
    """(9, height, width) of a block, on the processor: the six maps and the normal."""
    with torch.inference_mode():
        maps = source.maps(block)
        height, size = maps[5:], 2 * source.texel_size
        below, above = height[:, 2 * RING :, RING:-RING], height[:, : -2 * RING, RING:-RING]
        right, left = height[:, RING:-RING, 2 * RING :], height[:, RING:-RING, : -2 * RING]
        normals = normals_from_slopes((right - left) / size, (above - below) / size)
        if normal == "dx":
            normals[1].neg_()
        found: NDArray[np.float32] = torch.cat([inner(maps), normals]).cpu().numpy()
        return found


def inner(maps: Tensor) -> Tensor:
    """A block's maps without their ring."""
    return maps[..., RING:-RING, RING:-RING]


def material_source(
    material: MaterialLike, seed: int, period: Period | None = None, device: torch.device = _CPU
) -> MaterialSource:
    """The source of a material's field, computed on a device.

    Raises:
        UsageError: a seed or period out of range.
    """
    check_seed(seed)
    check_period(period, ALIGNMENT)
    decoder = material.folded().to(device)
    return MaterialSource(decoder, material.waves, material.texel_size, seed, period)


def field_source(
    material: MaterialLike,
    seed: int,
    period: Period | None = None,
    device: torch.device = _CPU,
    generator: Generator | None = None,
) -> MaterialSource | ExampleSource:
    """The source of a material's field: by example where it has an exemplar.

    Args:
        material: what to read.
        seed: which realisation.
        period: what repeats.
        device: where a decoder computes.
        generator: to insist on one.

    Raises:
        UsageError: a seed or period out of range, or no exemplar where one was asked for.
    """
    if generator == "decoder" or (generator is None and material.example is None):
        return material_source(material, seed, period, device)
    if material.example is None:
        raise no_exemplar()
    return example_source(material.example, seed, period)


def no_exemplar() -> UsageError:
    """What a material without an exemplar cannot do."""
    return UsageError(
        "this material has no exemplar",
        where="--generator example",
        remedy="capture the photograph again, or use its decoder",
    )
