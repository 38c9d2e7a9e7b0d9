"""Opens the field of a request: one material or a blend of two, by example or decoder.

Modules that need PyTorch are imported on demand: fields by example do not, and importing it takes
longer than synthesising a map.
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
    from matcap.synth.request import MaskedBlend, SynthRequest


@dataclass(frozen=True)
class OpenedField:
    """The field of a request, with what its JSON document says."""

    source: Source
    info: MapSetInfo
    """Name, seed, position and provenance."""
    choice: ChosenPrecision | None = None
    """Precision of a network; None by example."""


def open_field(asked: SynthRequest) -> tuple[SynthRequest, OpenedField]:
    """Open the field of a request; with `tile` "piece" the returned request has the tile's area.

    Raises:
        MatcapError: a file is missing, damaged, or not a material; the mask is not an image; the
            device does not support the precision.
        UsageError: a period out of range, no CUDA device, a generator that the material does not
            have, or a network's option with an exemplar.
    """
    if asked.tile == "piece":
        _check_piece(asked)
    exemplified = None
    if isinstance(asked.material, Path) and asked.blend is None:
        exemplified = (
            None if asked.read.generator == "decoder" else read_exemplified(asked.material)
        )
    if asked.blend is not None:
        source, name, provenance, choice = _blend(asked, asked.blend)
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
    """Raise UsageError for precision and device of an exemplar, which has neither choice."""
    given = {"--precision": asked.precision != "fp32", "--device": asked.device == "cuda"}
    for option in (option for option, holds in given.items() if holds):
        raise UsageError(
            "only the paper's network is computed in a precision and on a device",
            where=option,
            remedy="leave it out, or give --generator decoder",
        )


_FieldParts = tuple["Source", str, dict[str, Any], "ChosenPrecision | None"]


def _of_exemplar(asked: SynthRequest, exemplified: Exemplified) -> _FieldParts:
    """The field of an exemplar; imports no PyTorch."""
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


def _blend(asked: SynthRequest, blend: MaskedBlend) -> _FieldParts:
    """The request's material where the mask is black, the blend's where it is white."""
    from matcap.field.device import find_device
    from matcap.synth.blend import blend_source
    from matcap.synth.mask import read_mask
    from matcap.synth.precision import choose

    start, end = _loaded(asked.material, asked), _loaded(blend.material, asked)
    over = blend.over or asked.whole
    between = blend_source(
        start, end, read_mask(blend.mask, over, asked.period), asked.seed, asked.period,
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
    """Raise UsageError for options that do not apply to the exemplar as a tile."""
    refused = {
        "--udim": asked.udim is not None,
        "--blend": asked.blend is not None,
        "--variety": asked.read.variety is not None,
        "--seed": asked.seed != 0,
    }
    for option in (option for option, given in refused.items() if given):
        raise UsageError(
            "the photographed piece is one, of a size of its own",
            where=f"{option} with --tile piece",
            remedy=f"leave {option} out, or let the field repeat, with --tile alone",
        )
