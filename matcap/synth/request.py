"""Request for a rectangle of a field as files, the field that it opens, and its output plan."""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

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
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.field.plane import (
    BlockPart,
    Period,
    Rectangle,
    block_parts,
    check_rectangle,
    check_seed,
)
from matcap.field.source import DerivedSource
from matcap.files import settings as values
from matcap.files.names import (
    MAKER_VERSION,
    Progress,
    check_grid,
    ignore_progress,
    plain_name,
    tile_number,
)
from matcap.files.settings import CheckedSettings, refuse_options, setting
from matcap.synth.pictures import Preview, preview_of

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.field.material import Material
    from matcap.field.source import DeviceName, Source
    from matcap.files.settings import Size


# Request for a rectangle of a material's field as files, and how it is computed.
#
# Read next: fields.py (the field), plan.py (which files), stream.py (how they are written).


_ADDRESS = re.compile(r"[a-z]+://\S+|[^\s/:]+:\d{1,5}")


@dataclass(frozen=True)
class SynthArea:
    """Options of the rectangle."""

    size: Size | None = setting(None, metavar="WxH", parse=values.size, otherwise="1024x1024")
    """Size in texels: 4096x256, or 2K, 4K, 8K; limited by the disk only."""
    region: Rectangle | None = setting(None, metavar="x,y,w,h", parse=values.region)
    """Rectangle of the endless field (y downwards), instead of --size."""

    def __post_init__(self) -> None:
        if self.size is not None and self.region is not None:
            raise UsageError.at("--region", "a rectangle already has a size", "leave --size out")

    @property
    def rectangle(self) -> Rectangle:
        """The rectangle in texels of the field."""
        sides = self.size or values.DEFAULT_SIZE
        return self.region or Rectangle(0, 0, *sides)


@dataclass(frozen=True)
class SynthRequest(CheckedSettings):
    """A rectangle of a material's field, as files."""

    material: Material | Path
    """The material, or its file."""
    area: Rectangle
    """Texels of the field that the map set covers, or a texture set's upper left tile; ignored
    where `tile` is "piece"."""
    seed: int = setting(0, parse=values.seed, metavar="SEED")
    """Seed of the realisation, in [-2^63, 2^63)."""
    name: str = ""
    """Name of the map set, by default the material's."""
    read: ReadOptions = AS_IT_IS
    """Generator, variety and adjustments; recorded in the document's provenance."""
    tile: Literal["both", "x", "y", "piece"] | None = setting(
        None, words=("both", "x", "y", "piece")
    )
    """Make the maps seamless along both axes, or along x or y alone; piece: the photographed
    rectangle itself as a seamless tile, a little smaller than it is."""
    udim: tuple[int, int] | None = setting(None, metavar="CxR", parse=values.size)
    """A texture set of C columns (at most 10) and R rows (at most 900), each tile of the given
    size."""
    mipmap: bool = setting(False, option="mip")
    """Mip-mapped EXR files."""
    png: bool = setting(False)
    """Also write 16-bit PNGs."""
    preview: bool = setting(True)
    """Also write NAME_preview.png: about a megapixel, lit from the top, with the seam marked if the
    maps repeat."""
    normal: NormalStyle = setting("gl", words=("gl", "dx"))
    """Normals with +Y up (gl) or down (dx)."""
    device: DeviceName = setting("auto", words=("auto", "cpu", "cuda"))
    """Device that runs the network. auto: CUDA where PyTorch sees such a device."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_seed(self.seed)

    @property
    def whole(self) -> Rectangle:
        """Rectangle of the whole texture set, or of the only map set."""
        columns, rows = self.udim or (1, 1)
        area = self.area
        return Rectangle(area.x, area.y, area.width * columns, area.height * rows)

    @property
    def period(self) -> Period | None:
        """Period of the field along (x, y): the sides of `whole` where `tile` asks for it."""
        if self.tile is None:
            return None
        area = self.whole
        return None if self.tile == "y" else area.width, None if self.tile == "x" else area.height


@dataclass(frozen=True)
class SynthProgress(Progress):
    """Progress of a run."""

    rate: float = 0.0
    """Texels per second, without those of a resumed run."""


@dataclass(frozen=True)
class Work:
    """Settings of computing and writing a request."""

    workers: int = setting(1, least=1, most=1024, short="-j", otherwise="one a core")
    """Processes (threads for a few blocks, and on CUDA); their number changes no bit."""
    scheduler: str | None = setting(None, metavar="tcp://HOST:PORT")
    """Send blocks to this dask scheduler."""
    resume: bool = setting(False)
    """Continue an interrupted run of the same request."""
    progress: Callable[[SynthProgress], None] = ignore_progress
    """Called after every block."""
    overwrite: bool = True
    """Replace existing files, also those of another map set of the same name."""
    inputs: tuple[Path, ...] = ()
    """Input files, which are never replaced."""

    def check(self, device_type: str) -> None:
        """Raise UsageError for an invalid scheduler address, or a scheduler with CUDA."""
        if self.scheduler is not None and not _ADDRESS.fullmatch(self.scheduler):
            raise UsageError.at(
                "--scheduler",
                f"'{self.scheduler}' is not an address",
                "give one such as tcp://192.168.1.7:8786",
            )
        if self.scheduler is not None and device_type != "cpu":
            raise UsageError.at(
                "--scheduler",
                "a dask cluster computes on CPUs only",
                "leave --device out, or --scheduler",
            )


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
    from matcap.example.repeat import RepeatedSource
    from matcap.field.material import Material
    from matcap.field.source import Field

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
