"""Output plan of a request: map sets, the files of each, and their JSON document."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from matcap.brdf.folder import (
    EXR_BYTES,
    MEANINGS,
    PNG_BYTES,
    PNG_ENCODINGS,
    mapset_document,
    meaning_of,
)
from matcap.brdf.stated import NormalStyle
from matcap.errors import UsageError
from matcap.field.blocks import BlockPart, block_parts, check_rectangle
from matcap.field.plane import Rectangle
from matcap.files.maker import MAKER_VERSION
from matcap.files.names import plain_name
from matcap.files.udim import check_grid, tile_number
from matcap.synth.preview import Preview, preview_of

if TYPE_CHECKING:
    from matcap.field.source import Source
    from matcap.synth.fields import OpenedField
    from matcap.synth.request import SynthRequest

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
    """Preview to write, or None."""

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
    return int(whole * each + area * EXR_BYTES) + _SPARE  # the texels of one map set (assembly.py)


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
