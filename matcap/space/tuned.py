"""The fine-tuned decoder of a material, its source, and its part of a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import safe_open
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.stated import NormalStyle
from matcap.errors import UsageError
from matcap.example.example import Example, example_of
from matcap.field.field import repeatable
from matcap.field.header import REMEDY
from matcap.field.material import Material
from matcap.field.plane import RING, Grid, Period, Rectangle, Span, check_period, check_seed
from matcap.field.source import FieldGenerator, planes_of
from matcap.files.settings import bounded, whole
from matcap.files.tensors import StoredTensors
from matcap.flash.geometry import FlashSetup
from matcap.space.decoder import (
    ALIGNMENT,
    CODE_SIZE,
    DEPTH,
    DRAWING_CHANNELS,
    Decoder,
    DecoderConfig,
    Moments,
    maps_from_raw,
)
from matcap.space.freeze import Drawing, FoldedDecoder, Spans, fold, spans_of
from matcap.space.random_field import Patch, RandomField, lattice_field, noise_field
from matcap.statistics.lattice import Wave

# A decoder's configuration from a file, checked, as the file may be hostile.

# Limits of the memory that a hostile file can claim.
_LARGEST_WIDTH = 1024  # channels
_MOST_CELLS = 64  # channels at full resolution
_FINEST = 64  # texels of an exemplar along one of its drawing
_MOST_NUMBERS = 64_000_000  # weights, a quarter of a gigabyte


def decoder_config(stated: Mapping[str, Any]) -> DecoderConfig:
    """The configuration in a file's JSON description.

    Raises:
        ValueError, KeyError, IndexError, TypeError: an entry is missing or out of range.
    """
    config = DecoderConfig(
        noise_channels=int(stated["noise_channels"]),
        widths=tuple(int(width) for width in stated["widths"]),
        convolutions=(int(stated["convolutions"][0]), int(stated["convolutions"][1])),
        cells=int(stated["cells"]),
        drawing=int(stated.get("drawing", 0)),  # absent in the shipped prior
    )
    sizes = (config.noise_channels, *config.widths)
    if len(config.widths) != DEPTH + 1 or not all(1 <= s <= _LARGEST_WIDTH for s in sizes):
        raise ValueError(f"widths {config.widths} are not {DEPTH + 1} of at most {_LARGEST_WIDTH}")
    if not 0 <= config.cells <= _MOST_CELLS:
        raise ValueError(f"{config.cells} channels of cells")
    if stated.get("grains", 0) != 0:  # of earlier versions, by recipes that asked for it
        raise ValueError("a decoder of structured noise")
    if config.drawing not in (0, DRAWING_CHANNELS):
        raise ValueError(f"{config.drawing} channels of a drawing")
    if not all(1 <= count <= 4 for count in config.convolutions):
        raise ValueError(f"{config.convolutions} convolutions a block")
    return config


def config_document(config: DecoderConfig) -> dict[str, Any]:
    """The JSON description of a configuration; the inverse of decoder_config."""
    document = asdict(config)
    if not config.drawing:
        del document["drawing"]
    return document | {"grains": 0}  # structured noise of earlier versions


def empty_decoder(config: DecoderConfig) -> Decoder:
    """A decoder on the meta device, which has shapes but no memory.

    Raises:
        ValueError: it would have too many weights.
    """
    with torch.device("meta"):
        decoder = Decoder(config)
    count = sum(value.numel() for value in decoder.state_dict().values())
    if count > _MOST_NUMBERS:
        raise ValueError(f"{count} weights")
    return decoder


# The source of a decoder's field, which computes its blocks.


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


# The fine-tuned decoder of a material, and its part of a material's file.

_CPU = torch.device("cpu")


@dataclass(frozen=True)
class TunedDecoder:
    """The decoder of one material."""

    decoder: Decoder
    """The decoder, with fine-tuned weights."""
    code: Tensor
    """(CODE_SIZE,) latent vector it was fine-tuned at."""
    moments: tuple[Moments, ...]
    """Frozen AdaIN statistics, one pair a layer."""
    waves: tuple[Wave, ...]
    """Frequencies of the material's lattice; empty for most materials."""
    texel_size: float
    """A texel's side, plane units."""
    drawing: Drawing | None = None
    """What it reads besides noise, or None as in the paper."""
    turned: bool = False
    """Whether its field is rotated upright, 90 degrees clockwise, of a portrait."""

    @property
    def alignment(self) -> int:
        """Texels: periods of its field are multiples of this."""
        return ALIGNMENT if self.drawing is None else max(ALIGNMENT, self.drawing.alignment)

    @property
    def piece_size(self) -> None:
        """None: there is no exemplar."""
        return None

    def piece(self) -> None:
        """None: there is no exemplar."""
        return None

    def material(
        self, name: str, setup: FlashSetup, provenance: Mapping[str, Any] | None = None
    ) -> Material:
        """A material with this decoder as its only generator; arguments as in Material."""
        tuned = replace(self, turned=setup.turned)
        return Material(name, {"decoder": tuned}, self.texel_size, setup, provenance or {})

    @cached_property
    def folded(self) -> FoldedDecoder:
        """The decoder with AdaIN folded into its convolutions."""
        return fold(self.decoder, self.code, self.moments, has_waves=bool(self.waves))

    def source(
        self, seed: int, period: Period | None = None, device: torch.device = _CPU
    ) -> DecoderSource:
        """The field of a seed and period, computed on a device.

        Raises:
            UsageError: a seed or period out of range.
        """
        check_seed(seed)
        check_period(period, self.alignment)
        field = (self.folded.to(device), self.waves, self.texel_size, seed, period)
        return DecoderSource(*field, drawing=self.drawing, turned=self.turned)

    def varied(self, variety: float) -> TunedDecoder:
        """Decoders have no variety.

        Raises:
            UsageError: always.
        """
        raise UsageError.at(
            "--variety",
            f"a decoder rearranges no patches, so it has no variety of {variety:g}",
            "leave it out, or give --generator example",
        )

    def repeating(self) -> MapSet:
        """Decoders have no exemplar to make a tile of.

        Raises:
            UsageError: always.
        """
        raise UsageError.at(
            "--tile piece",
            "a decoder has no exemplar to repeat",
            "give --tile alone for a periodic texture, or capture with --generator example",
        )

    def in_file(
        self, by_example: FieldGenerator | None = None
    ) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors by name, and entries of the JSON description; the inverse of read()."""
        tensors = {f"decoder.{k}": v for k, v in self.decoder.state_dict().items()}
        tensors["code"] = self.code
        for index, (mean, deviation) in enumerate(self.moments):
            tensors[f"moments.{index}.mean"] = mean
            tensors[f"moments.{index}.deviation"] = deviation
        about: dict[str, Any] = {
            "decoder": config_document(self.decoder.config),
            "waves": [wave._asdict() for wave in self.waves],
        }
        drawing = self.drawing
        if drawing is not None:
            about["drawing"] = {}
            if drawing.example is not by_example:
                read, described = drawing.example.in_file(entry="drawing")
                tensors |= read
                about |= described
            if drawing.finer > 1:
                about["drawing"] |= {"finer": drawing.finer}
            if drawing.turned:
                about["drawing"] |= {"turned": True}
        return tensors, about


def read(
    about: Mapping[str, Any], file: safe_open, path: Path, by_example: FieldGenerator | None
) -> TunedDecoder | None:
    """Read the decoder of a material's file, or None if it has none.

    Args:
        about: the file's JSON description.
        file: opened for PyTorch.
        by_example: the file's generator by example, which the decoder may draw from.

    Raises:
        MatcapError: a tensor is missing or of a wrong shape.
        DAMAGED (field/header.py): the description is malformed.
    """
    if "decoder" not in about:
        return None
    stored = StoredTensors(file, path, REMEDY)
    config = decoder_config(about["decoder"])
    decoder = stored.load(empty_decoder(config), "decoder.")
    code = stored.tensor("code", (CODE_SIZE,))
    moments = []
    for index, layer in enumerate(decoder.layers()):
        shape = (layer.convolution.weight.shape[0],)
        mean = stored.tensor(f"moments.{index}.mean", shape)
        deviation = stored.tensor(f"moments.{index}.deviation", shape)
        moments.append((mean, deviation))
    drawing = _drawing(about, file, by_example) if config.drawing else None
    texel_size = about["texel_size"] if drawing is None else drawing.texel_size
    return TunedDecoder(
        decoder=decoder,
        code=code,
        moments=tuple(moments),
        waves=tuple(
            Wave(bounded(w["fx"], "fx", -1.0, 1.0), bounded(w["fy"], "fy", -1.0, 1.0))
            for w in about["waves"][:2]
        ),
        texel_size=bounded(texel_size, "texel_size", 1e-9, 1e3),
        drawing=drawing,
        turned=about["setup"]["turned"],
    )


def _drawing(
    about: Mapping[str, Any], file: safe_open, by_example: FieldGenerator | None
) -> Drawing:
    """The drawing of an exemplar of its own, or of the material's."""
    entry = about["drawing"]
    finer = whole(entry.get("finer", 1), "finer", 1, _FINEST)
    if finer & (finer - 1):
        raise ValueError(f"finer is {finer}, no power of two")
    turned = entry.get("turned", False) is True
    if "exemplar" in entry:
        return Drawing(example_of(about, file, "drawing"), finer, turned)
    if not isinstance(by_example, Example):
        raise ValueError("the exemplar that the decoder draws from is missing")
    return Drawing(by_example, finer, turned)
