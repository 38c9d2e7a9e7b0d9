"""The field that was asked for: of one material or between two, by example or by the network.

By example without PyTorch, which alone takes longer to start than a map takes to make: so its
modules are imported where they are needed.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.example.stored import read_exemplified
from matcap.field.opened import REPEATS

if TYPE_CHECKING:
    from matcap.field.device import DeviceName
    from matcap.field.material import Material
    from matcap.field.plane import Period, Rectangle
    from matcap.field.source import Generator, Source
    from matcap.synth.precision import ChosenPrecision, Precision


@dataclass(frozen=True)
class Wanted:
    """Which field of a material.

    Attributes:
        seed: which realisation.
        period: what repeats.
        generator: "example" or "decoder"; None: by example where there is an exemplar.
        precision: of the network.
        device: where the network computes.
        variety: that an exemplar is rearranged with, instead of its material's own.
    """

    seed: int = 0
    period: Period | None = None
    generator: Generator | None = None
    precision: Precision = "fp32"
    device: DeviceName = "cpu"
    variety: float | None = None


@dataclass(frozen=True)
class OpenedField:
    """A field with what is told of it.

    Attributes:
        source: of its blocks.
        name: of the material.
        provenance: how it was made; JSON.
        choice: of a decoder's precision.
    """

    source: Source
    name: str
    provenance: dict[str, Any]
    choice: ChosenPrecision | None = None


def open_field(material: Path | Material, wanted: Wanted) -> OpenedField:
    """The field of one material.

    Args:
        material: itself, or its file.
        wanted: which of its fields.

    Raises:
        MatcapError: the file is missing, damaged, or no material; the device is not there, or
            does not compute in this precision.
        UsageError: a seed or period out of range, or no exemplar where one was asked for.
    """
    if isinstance(material, Path) and wanted.generator != "decoder":
        held = read_exemplified(material)
        if held is not None:
            source = held.example.varied(wanted.variety).source(wanted.seed, wanted.period)
            return OpenedField(source, held.name, held.provenance)
    from matcap.field.field import Field
    from matcap.field.source import Network
    from matcap.synth.precision import choose

    subject = _loaded(material, wanted)
    field = Field(
        subject, wanted.seed, wanted.period, device=wanted.device, generator=wanted.generator
    ).source
    provenance = dict(subject.provenance)
    if not isinstance(field, Network):
        return OpenedField(field, subject.name, provenance)
    choice = choose(field, wanted.precision)
    return OpenedField(choice.source, subject.name, provenance, choice)


def open_repeating(material: Path | Material, generator: Generator | None) -> OpenedField:
    """The photographed piece itself, made to repeat: one period of it.

    Args:
        material: itself, or its file.
        generator: that it is asked of; only an exemplar holds a piece.

    Raises:
        MatcapError: the file is missing, damaged, or no material.
        UsageError: it holds no photographed piece, or too small a one.
    """
    if isinstance(material, Path) and generator != "decoder":
        held = read_exemplified(material)
        if held is not None:
            return OpenedField(
                held.example.repeating_source(), held.name, held.provenance | REPEATS
            )
    from matcap.example.repeat.source import RepeatedSource

    subject = _loaded(material, Wanted(generator=generator))
    maps = subject.repeating()
    source = RepeatedSource(maps.stacked().numpy(), maps.texel_size)
    return OpenedField(source, subject.name, dict(subject.provenance) | REPEATS)


def open_blend(
    first: Path | Material, second: Path | Material, mask: Path, over: Rectangle, wanted: Wanted
) -> OpenedField:
    """The field that is the first material where a mask is black, the second where it is white.

    Args:
        first: itself, or its file.
        second: likewise.
        mask: a grey picture,
        over: stretched over this.
        wanted: which of their fields.

    Raises:
        MatcapError, UsageError: as open_field; or the mask is no picture.
    """
    from matcap.field.device import find_device
    from matcap.synth.blend import blend_source
    from matcap.synth.mask import read_mask
    from matcap.synth.precision import choose

    start, end = _loaded(first, wanted), _loaded(second, wanted)
    between = blend_source(
        start, end, read_mask(mask, over, wanted.period), wanted.seed, wanted.period,
        find_device(wanted.device), wanted.generator,
    )  # fmt: skip
    choice = choose(between, wanted.precision)
    told = {"blend": [start.name, end.name], "mask_over": list(astuple(over))}
    return OpenedField(choice.source, start.name, dict(start.provenance) | told, choice)


def _loaded(material: Path | Material, wanted: Wanted) -> Material:
    from matcap.field.material import Material

    found = Material.load(material) if isinstance(material, Path) else material
    return found.by(wanted.generator).varied(wanted.variety)
