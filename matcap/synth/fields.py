"""The field of a request: of one material or between two, by example or by the network.

By example without PyTorch, which alone takes longer to start than a map takes to make: so its
modules are imported where they are needed.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.brdf.adjust import KEY
from matcap.brdf.folder import MapSetInfo
from matcap.errors import UsageError
from matcap.example.stored import Exemplified, read_exemplified
from matcap.field.opened import REPEATS
from matcap.field.plane import Rectangle
from matcap.synth.adjusted import adjusted_source

if TYPE_CHECKING:
    from matcap.field.material import Material
    from matcap.field.source import Source
    from matcap.synth.precision import ChosenPrecision
    from matcap.synth.request import Growth, SynthRequest


@dataclass(frozen=True)
class OpenedField:
    """The opened field of a request, with its name, provenance and precision."""

    source: Source
    """Of its blocks."""
    info: MapSetInfo
    """Name, seed, place and provenance."""
    choice: ChosenPrecision | None = None
    """A network's precision."""


def open_field(asked: SynthRequest) -> tuple[SynthRequest, OpenedField]:
    """The field of a request, and the request itself with the size of a piece that repeats.

    Raises:
        MatcapError: a file is missing, damaged, or no material; the mask is no picture; the device
            is not there, or does not compute in this precision.
        UsageError: a period out of range, no exemplar where one was asked for, or a network's
            option where there is none.
    """
    if asked.tile == "piece":
        _check_piece(asked)
    exemplified = None
    if isinstance(asked.material, Path) and asked.growth is None:
        exemplified = (
            None if asked.read.generator == "decoder" else read_exemplified(asked.material)
        )
    if asked.growth is not None:
        source, name, provenance, choice = _blend(asked, asked.growth)
    elif exemplified is not None:
        source, name, provenance, choice = _of_exemplar(asked, exemplified)
    else:
        source, name, provenance, choice = _of_material(asked)
    if choice is None:
        _refuse_networks_options(asked)
    if asked.tile == "piece":
        width, height = source.period or (0, 0)
        asked = replace(asked, area=Rectangle(0, 0, width or 0, height or 0))
        provenance |= REPEATS
    adjust = asked.read.adjustments
    provenance |= {KEY: adjust.text} if adjust.changes else {}
    provenance |= {"variety": asked.read.variety} if asked.read.variety is not None else {}
    info = MapSetInfo(asked.name or name, asked.seed, (asked.area.x, asked.area.y), provenance)
    return asked, OpenedField(adjusted_source(source, adjust), info, choice)


def _refuse_networks_options(asked: SynthRequest) -> None:
    """A photographed piece is rearranged in whole numbers, on the processor."""
    given = {"--precision": asked.precision != "fp32", "--device": asked.device == "cuda"}
    for option in (option for option, holds in given.items() if holds):
        raise UsageError(
            "only the paper's network is computed in a precision and on a device",
            where=option,
            remedy="leave it out, or give --generator decoder",
        )


_FieldParts = tuple["Source", str, dict[str, Any], "ChosenPrecision | None"]


def _of_exemplar(asked: SynthRequest, exemplified: Exemplified) -> _FieldParts:
    """Without PyTorch."""
    example = exemplified.example
    if asked.tile == "piece":
        return example.repeating_source(), exemplified.name, dict(exemplified.provenance), None
    source = example.varied(asked.read.variety).source(asked.seed, asked.period)
    return source, exemplified.name, dict(exemplified.provenance), None


def _of_material(asked: SynthRequest) -> _FieldParts:
    from matcap.example.repeat.source import RepeatedSource
    from matcap.field.field import Field
    from matcap.field.source import Network
    from matcap.synth.precision import choose

    material = _loaded(asked.material, asked)
    name, provenance = material.name, dict(material.provenance)
    if asked.tile == "piece":
        maps = material.repeating()
        source: Source = RepeatedSource(maps.stacked().numpy(), maps.texel_size)
        return source, name, provenance, None
    source = Field(
        material, asked.seed, asked.period, device=asked.device, generator=asked.read.generator
    ).source
    if not isinstance(source, Network):
        return source, name, provenance, None
    choice = choose(source, asked.precision)
    return choice.source, name, provenance, choice


def _blend(asked: SynthRequest, growth: Growth) -> _FieldParts:
    """The first material where the mask is black, the second where it is white."""
    from matcap.field.device import find_device
    from matcap.synth.blend import blend_source
    from matcap.synth.mask import read_mask
    from matcap.synth.precision import choose

    start, end = _loaded(asked.material, asked), _loaded(growth.material, asked)
    over = growth.over or asked.whole
    between = blend_source(
        start, end, read_mask(growth.mask, over, asked.period), asked.seed, asked.period,
        find_device(asked.device), asked.read.generator,
    )  # fmt: skip
    choice = choose(between, asked.precision)
    mask_provenance = {"blend": [start.name, end.name], "mask_over": list(astuple(over))}
    return choice.source, start.name, dict(start.provenance) | mask_provenance, choice


def _loaded(material: Path | Material, asked: SynthRequest) -> Material:
    from matcap.field.material import Material

    opened = Material.load(material) if isinstance(material, Path) else material
    return opened.by(asked.read.generator).varied(asked.read.variety)


def _check_piece(asked: SynthRequest) -> None:
    """Raise UsageError for what cannot be asked of the photographed piece itself."""
    refused = {
        "--udim": asked.udim is not None,
        "--blend": asked.growth is not None,
        "--variety": asked.read.variety is not None,
        "--seed": asked.seed != 0,
    }
    for option in (option for option, given in refused.items() if given):
        raise UsageError(
            "the photographed piece is one, of a size of its own",
            where=f"{option} with --tile piece",
            remedy=f"leave {option} out, or let the field repeat, with --tile alone",
        )
