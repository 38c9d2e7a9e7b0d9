"""The field of a request, and its output plan: map sets, their files, and their JSON document."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.adjust import KEY, Adjustments, adjusted_planes
from matcap.brdf.folder import (
    EXR_BYTES,
    MEANINGS,
    PNG_BYTES,
    PNG_ENCODINGS,
    MapSetInfo,
    mapset_document,
    meaning_of,
)
from matcap.brdf.stated import NormalStyle
from matcap.errors import UsageError
from matcap.example.example import Exemplified, read_exemplified
from matcap.field.opened import REPEATS, refuse_with_piece
from matcap.field.plane import BlockPart, Grid, Period, Rectangle, block_parts, check_rectangle
from matcap.files.names import MAKER_VERSION, check_grid, plain_name, tile_number
from matcap.files.settings import refuse_options
from matcap.synth.pictures import Preview, preview_of

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.field.source import Source
from matcap.synth.request import SynthRequest

# Opens the field of a request, by example or decoder.
#
# Modules that need PyTorch are imported on demand: fields by example do not, and importing it takes
# longer than synthesising a map.


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
            {"--udim": request.udim, "--variety": request.read.variety, "--seed": request.seed != 0}
        )
    exemplified = None
    if isinstance(request.material, Path) and request.read.generator != "decoder":
        exemplified = read_exemplified(request.material)
    wanted = "example" if request.tile == "piece" else request.read.generator
    if exemplified is not None and (wanted or exemplified.default) == "example":
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
    source = AdjustedSource.of(source, adjust) if adjust.changes else source
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
    from matcap.example.repeat import RepeatedSource
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
class AdjustedSource:
    """A source with adjustments, else as the source is; picklable if that is."""

    source: Source
    adjustments: Adjustments
    texel_size: float
    grid: Grid
    period: Period | None
    specular_channels: int
    device_type: str

    @staticmethod
    def of(source: Source, adjustments: Adjustments) -> AdjustedSource:
        """The source with these adjustments."""
        grid, period, channels = source.grid, source.period, source.specular_channels
        size, device = source.texel_size, source.device_type
        return AdjustedSource(source, adjustments, size, grid, period, channels, device)

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps of a block and its ring."""
        import torch

        maps = self.source.maps(block)
        return torch.from_numpy(adjusted_planes(maps.cpu().numpy(), self.adjustments))

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) maps and normal of a block."""
        return adjusted_planes(self.source.planes(block, normal), self.adjustments)


# Output plan of a request: map sets, the files of each, and their JSON document.

_LARGEST_SIDE = 2**31 - 1  # texels, of an OpenEXR file
_SPARE = 5_000_000  # bytes for headers, the JSON file and the preview


@dataclass(frozen=True)
class PlannedMapSet:
    """A map set to write: the whole request, or one tile of a texture set."""

    area: Rectangle
    files: Mapping[str, str]
    """Names of the EXR files by map."""
    normal: NormalStyle
    preview: Preview | None

    def shows(self, part: BlockPart) -> bool:
        """Whether the preview shows some of a part."""
        return self.preview is not None and bool(self.preview.places(self.area, part))

    def parts(self, source: Source) -> Iterator[BlockPart]:
        """Yield its parts by block, in the order of their computation."""
        return block_parts(self.area, source.grid, source.period)


def check_request(request: SynthRequest, name: str) -> None:
    """Raise UsageError for an empty or too large rectangle, or a bad name or texture set."""
    plain_name(name)
    check_grid(*(request.udim or (1, 1)))
    check_rectangle(request.area)
    check_rectangle(request.whole)
    side = max(request.area.width, request.area.height)
    if side > _LARGEST_SIDE:
        raise UsageError(
            f"a side of {side} texels is more than an OpenEXR file holds",
            remedy=f"ask for at most {_LARGEST_SIDE}, or for tiles with --udim",
        )


def bytes_of(request: SynthRequest) -> int:
    """Upper bound of the disk space that a run takes, in bytes."""
    whole, area = (one.width * one.height for one in (request.whole, request.area))
    each = EXR_BYTES * (4 / 3 if request.mipmap else 1)
    each += PNG_BYTES if request.png else 0
    return int(whole * each + area * EXR_BYTES) + _SPARE  # the texels of one map set (pictures.py)


def key_of(request: SynthRequest, field: OpenedField) -> str:
    """Key that decides whether an interrupted run can be resumed: a digest, and the device.

    Requests of equal keys write files of the same bytes.
    """
    digest = hashlib.sha256()
    versions = (MAKER_VERSION, version("torch"))
    stored = (
        request.area,
        field.info.name,
        request.png,
        request.normal,
        request.mipmap,
        request.preview,
    )
    _feed(digest.update, (versions, field.source, *stored, request.udim))
    return f"{digest.hexdigest()} {field.source.device_type}"


def mapsets_of(request: SynthRequest, field: OpenedField) -> list[PlannedMapSet]:
    """The map sets to write: left to right, the lowest row of a texture set first."""
    area, columns, rows = request.area, *(request.udim or (1, 1))
    preview = preview_of(request.whole, field.source.period) if request.preview else None
    sets = []
    for row in range(rows):
        for column in range(columns):
            # A texture set's rows are counted upwards.
            x, y = area.x + column * area.width, area.y + (rows - 1 - row) * area.height
            label = "" if request.udim is None else f".{tile_number(column, row)}"
            files = {kind: f"{field.info.name}_{kind}{label}.exr" for kind in MEANINGS}
            place = Rectangle(x, y, area.width, area.height)
            sets.append(PlannedMapSet(place, files, request.normal, preview))
    return sets


def document_of(
    request: SynthRequest, field: OpenedField, heights: tuple[float, float] | None
) -> dict[str, Any]:
    """The JSON document of a map set or texture set.

    Args:
        heights: (scale, midlevel) of height PNGs, or None without PNGs.
    """
    source, whole, name = field.source, request.whole, field.info.name
    period, specular = source.period, source.specular_channels
    document = mapset_document(
        field.info,
        (request.area.width, request.area.height),
        source.texel_size,
        periodic=period == (whole.width, whole.height) and request.udim is None,
        normal=request.normal,
        specular=specular,
    )
    label = "" if request.udim is None else ".<UDIM>"
    if request.udim is not None:
        document |= {"format": "matcap texture set", "udim": list(request.udim)}
    if period is not None:
        document["period"] = list(period)
    for kind in MEANINGS:
        file = f"{name}_{kind}{label}.exr"
        document["maps"][kind] = {"file": file, "meaning": meaning_of(kind, specular)}
        if request.png:
            png = f"{name}_{kind}{label}.png"
            document["maps"][kind] |= {"png": png, "png_encoding": PNG_ENCODINGS[kind]}
    if heights is not None:
        document["png"] = {"height_scale": heights[0], "height_midlevel": heights[1]}
    return document


def wrap_modes(request: SynthRequest, source: Source) -> str:
    """OpenImageIO's wrap modes along x and y, for mip-mapped files; "" for others."""
    if not request.mipmap:
        return ""
    whole, period = request.whole, source.period or (None, None)
    sides = zip(period, (whole.width, whole.height), strict=True)
    modes = ("periodic" if repeat == side else "clamp" for repeat, side in sides)
    return "clamp,clamp" if request.udim else ",".join(modes)


def _feed(update: Callable[[bytes], object], value: object) -> None:
    """Update a digest with a value: dataclasses and tuples recursively, arrays by their bytes."""
    if is_dataclass(value):
        value = (type(value).__name__, *(getattr(value, part.name) for part in fields(value)))
    torch = sys.modules.get("torch")  # if it is not loaded, the value holds no tensor
    if torch is not None and isinstance(value, torch.Tensor):
        update(repr((value.dtype, tuple(value.shape))).encode())
        update(value.detach().cpu().contiguous().view(torch.uint8).numpy().tobytes())
    elif isinstance(value, np.ndarray):
        update(repr((value.dtype, value.shape)).encode() + value.tobytes())
    elif isinstance(value, tuple):
        update(b"(")
        for part in value:
            _feed(update, part)
        update(b")")
    else:
        update(repr(value).encode() + b",")
