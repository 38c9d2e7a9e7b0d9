"""Opens the field of a request, by example or decoder.

Modules that need PyTorch are imported on demand: fields by example do not, and importing it takes
longer than synthesising a map.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.adjust import KEY, Adjustments, adjusted_planes
from matcap.brdf.folder import MapSetInfo
from matcap.brdf.stated import NormalStyle
from matcap.example.stored import Exemplified, read_exemplified
from matcap.field.opened import REPEATS, refuse_with_piece
from matcap.field.plane import Rectangle
from matcap.field.source import DerivedSource
from matcap.files.settings import refuse_options

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.field.source import Source
    from matcap.synth.request import SynthRequest


@dataclass(frozen=True)
class OpenedField:
    """The field of a request, with what its JSON document says."""

    source: Source
    info: MapSetInfo
    """Name, seed, position and provenance."""


def open_field(request: SynthRequest) -> tuple[SynthRequest, OpenedField]:
    """Open the field of a request; with `tile` "piece" the returned request has the tile's area.

    Raises:
        MatcapError: a file is missing, damaged, or not a material.
        UsageError: a period out of range, no CUDA device, a generator that the material does not
            have, or a network's option with an exemplar.
    """
    if request.tile == "piece":
        refuse_with_piece(
            {
                "--udim": request.udim,
                "--variety": request.read.variety,
                "--seed": request.seed != 0,
            }
        )
    exemplified = None
    if isinstance(request.material, Path) and request.read.generator != "decoder":
        exemplified = read_exemplified(request.material)
    if exemplified is not None:
        source, name, provenance = _of_exemplar(request, exemplified)
    else:
        source, name, provenance = _of_material(request)
    refuse_options(
        {"--device": request.device == "cuda" and source.device_type == "cpu"},
        "only the decoder (the paper's network) has a choice of device",
        "leave it out, or give --generator decoder",
    )
    if request.tile == "piece":
        width, height = source.period or (0, 0)
        request = replace(request, area=Rectangle(0, 0, width or 0, height or 0))
        provenance |= REPEATS
    adjust = request.read.adjustments
    provenance |= {KEY: adjust.text} if adjust.changes else {}
    provenance |= {"variety": request.read.variety} if request.read.variety is not None else {}
    info = MapSetInfo(
        request.name or name, request.seed, (request.area.x, request.area.y), provenance
    )
    source = AdjustedSource(source, adjust) if adjust.changes else source
    return request, OpenedField(source, info)


_FieldParts = tuple["Source", str, dict[str, Any]]


def _of_exemplar(request: SynthRequest, exemplified: Exemplified) -> _FieldParts:
    """The field of an exemplar; imports no PyTorch."""
    example = exemplified.example
    if request.tile == "piece":
        source: Source = example.repeating_source()
    else:
        source = example.varied(request.read.variety).source(request.seed, request.period)
    return source, exemplified.name, dict(exemplified.provenance)


def _of_material(request: SynthRequest) -> _FieldParts:
    from matcap.example.repeat.source import RepeatedSource
    from matcap.field.field import Field
    from matcap.field.material import Material

    given = request.material
    material = Material.load(given) if isinstance(given, Path) else given
    material = material.by(request.read.generator).varied(request.read.variety)
    name, provenance = material.name, dict(material.provenance)
    if request.tile == "piece":
        maps = material.repeating()
        source: Source = RepeatedSource(maps.stacked().numpy(), maps.texel_size)
        return source, name, provenance
    source = Field(
        material,
        request.seed,
        request.period,
        device=request.device,
        generator=request.read.generator,
    ).source
    return source, name, provenance


@dataclass(frozen=True)
class AdjustedSource(DerivedSource):
    """A source with adjustments; picklable if the inner source is."""

    adjustments: Adjustments

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps of a block and its ring."""
        import torch

        maps = self.source.maps(block)
        return torch.from_numpy(adjusted_planes(maps.cpu().numpy(), self.adjustments))

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) maps and normal of a block."""
        return adjusted_planes(self.source.planes(block, normal), self.adjustments)
