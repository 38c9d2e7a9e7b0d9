"""What is asked of stream.py: which rectangle, which files, by whom; and what that comes to."""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

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
from matcap.field.blocks import Piece, check_rectangle, pieces_of
from matcap.field.plane import Rectangle
from matcap.files.maker import MAKER_VERSION
from matcap.files.names import plain_name
from matcap.files.progress import Progress, nobody
from matcap.synth.pictures import PictureFile, channels_of, pictures_of

if TYPE_CHECKING:
    from matcap.field.source import Source

_ADDRESS = re.compile(r"[a-z]+://\S+|[^\s/:]+:\d{1,5}")

_UDIM_COLUMNS = 10
_UDIM_ROWS = 900
_LARGEST_SIDE = 2**31 - 1  # texels, of an OpenEXR file
_SPARE = 1_000_000  # bytes, for headers and the JSON file


@dataclass(frozen=True)
class Files:
    """How maps are stored.

    Attributes:
        png: 16-bit PNGs beside the EXR files.
        normal: "gl" or "dx".
        single: one EXR file with all maps.
        mipmap: with all smaller levels.
        udim: (columns, rows) of a texture set, or None for one map set.
    """

    png: bool = False
    normal: NormalStyle = "gl"
    single: bool = False
    mipmap: bool = False
    udim: tuple[int, int] | None = None

    def whole(self, area: Rectangle) -> Rectangle:
        """All of a texture set whose left top tile is `area`; otherwise the area itself."""
        columns, rows = self.udim or (1, 1)
        return Rectangle(area.x, area.y, area.width * columns, area.height * rows)


@dataclass(frozen=True)
class SynthProgress(Progress):
    """How far a run has come.

    Attributes:
        rate: texels a second, what was resumed left out.
        resumed: share of the whole that was there before.
    """

    rate: float = 0.0
    resumed: float = 0.0


@dataclass(frozen=True)
class Work:
    """Who does it.

    Attributes:
        workers: processes (threads for a few blocks, and on CUDA); their number changes no bit.
        scheduler: address of a dask scheduler to send blocks to instead.
        resume: go on with what an interrupted run of the same request left.
        progress: called after every block.
        overwrite: replace what stands in the way, another map set of the same name too.
        inputs: files that are read, and never replaced.
    """

    workers: int = 1
    scheduler: str | None = None
    resume: bool = False
    progress: Callable[[SynthProgress], None] = nobody
    overwrite: bool = True
    inputs: tuple[Path, ...] = ()

    def check(self, device_type: str) -> None:
        """Raise UsageError for what is no address, or a device that a cluster may not have."""
        if self.scheduler is not None and not _ADDRESS.fullmatch(self.scheduler):
            raise UsageError(
                f"'{self.scheduler}' is no address",
                where="--scheduler",
                remedy="give one such as tcp://192.168.1.7:8786",
            )
        if self.scheduler is not None and device_type != "cpu":
            raise UsageError(
                "a cluster computes on its processors",
                where="--scheduler",
                remedy="leave --device out, or --scheduler",
            )


@dataclass(frozen=True)
class PlannedMapSet:
    """One map set's worth of a request: the whole of it, or one tile of a texture set."""

    area: Rectangle
    pictures: tuple[PictureFile, ...]


@dataclass(frozen=True)
class Request:
    """A rectangle of a field, as files.

    Attributes:
        source: of the blocks.
        area: of the one map set, or of a texture set's left top tile.
        info: name, seed, provenance.
        files: how to store them.
    """

    source: Source
    area: Rectangle
    info: MapSetInfo
    files: Files = field(default_factory=Files)

    def check(self) -> None:
        """Raise UsageError for an empty or too large rectangle, or a bad name or texture set."""
        plain_name(self.info.name)
        columns, rows = self.files.udim or (1, 1)
        if not (1 <= columns <= _UDIM_COLUMNS and 1 <= rows <= _UDIM_ROWS):
            raise UsageError(
                f"a texture set of {columns}x{rows} tiles",
                remedy=f"ask for at most {_UDIM_COLUMNS} columns and {_UDIM_ROWS} rows",
            )
        check_rectangle(self.area)
        check_rectangle(self.whole)
        if max(self.area.width, self.area.height) > _LARGEST_SIDE:
            raise UsageError(
                f"a side of {max(self.area.width, self.area.height)} texels is more than an "
                f"OpenEXR file holds",
                remedy=f"ask for at most {_LARGEST_SIDE}, or for tiles with --udim",
            )

    @property
    def whole(self) -> Rectangle:
        """All of the texture set, or of the one map set."""
        return self.files.whole(self.area)

    @property
    def room(self) -> int:
        """Bytes of disk that the files take at most."""
        each = EXR_BYTES * (4 / 3 if self.files.mipmap else 1)
        each += PNG_BYTES if self.files.png else 0
        return int(self.whole.width * self.whole.height * each) + _SPARE

    @property
    def key(self) -> str:
        """The same for requests whose files have the same bytes: a digest, and the device."""
        digest = hashlib.sha256()
        versions = (MAKER_VERSION, version("torch"))
        _feed(digest.update, (versions, self.source, self.area, self.info.name, self.files))
        return f"{digest.hexdigest()} {self.source.device_type}"

    def mapsets(self) -> list[PlannedMapSet]:
        """The map sets to write, left to right, the lowest row of a texture set first."""
        name, area = self.info.name, self.area
        wrap = self._wrap()
        if self.files.udim is None:
            return [PlannedMapSet(area, self._pictures(f"{name}_{{kind}}", wrap))]
        columns, rows = self.files.udim
        return [
            PlannedMapSet(
                # A texture set's rows are counted upwards.
                Rectangle(
                    area.x + column * area.width,
                    area.y + (rows - 1 - row) * area.height,
                    area.width,
                    area.height,
                ),
                self._pictures(f"{name}_{{kind}}.{udim_number(column, row)}", wrap),
            )
            for row in range(rows)
            for column in range(columns)
        ]

    def pieces(self, mapset: PlannedMapSet) -> Iterator[Piece]:
        """What every block gives to a map set, in order."""
        return pieces_of(mapset.area, self.source.grid, self.source.period)

    def document(self, heights: tuple[float, float] | None) -> dict[str, Any]:
        """The JSON document.

        Args:
            heights: scale and midlevel of height PNGs, where there are any.
        """
        files, whole, period = self.files, self.whole, self.source.period
        document = mapset_document(
            self.info,
            (self.area.width, self.area.height),
            self.source.texel_size,
            periodic=period == (whole.width, whole.height) and files.udim is None,
            normal=files.normal,
            specular=self.source.specular_channels,
        )
        label = "" if files.udim is None else ".<UDIM>"
        if files.udim is not None:
            document |= {"format": "matcap texture set", "udim": list(files.udim)}
        if period is not None:
            document["period"] = list(period)
        name = self.info.name
        specular = self.source.specular_channels
        for kind in MEANINGS:
            file = f"{name}_{'maps' if files.single else kind}{label}.exr"
            document["maps"][kind] = {"file": file, "meaning": meaning_of(kind, specular)}
            if files.single:
                channels = channels_of(kind, specular=specular, single=True)
                document["maps"][kind]["channels"] = list(channels)
            if files.png:
                png = f"{name}_{kind}{label}.png"
                document["maps"][kind] |= {"png": png, "png_encoding": PNG_ENCODINGS[kind]}
        if heights is not None:
            document["png"] = {"height_scale": heights[0], "height_midlevel": heights[1]}
        return document

    def _pictures(self, name: str, wrap: str) -> tuple[PictureFile, ...]:
        size = (self.area.width, self.area.height)
        files, specular = self.files, self.source.specular_channels
        return pictures_of(
            name, size, specular=specular, single=files.single, mipmap=files.mipmap, wrap=wrap
        )

    def _wrap(self) -> str:
        """How a texture reader continues the picture beyond its borders."""
        if not self.files.mipmap:
            return ""
        whole, period = self.whole, self.source.period or (None, None)
        sides = zip(period, (whole.width, whole.height), strict=True)
        modes = ("periodic" if repeat == side else "clamp" for repeat, side in sides)
        return "clamp,clamp" if self.files.udim else ",".join(modes)


def _feed(update: Callable[[bytes], object], value: object) -> None:
    """Tell a digest of everything that a value is made of."""
    if is_dataclass(value):
        value = (type(value).__name__, *(getattr(value, part.name) for part in fields(value)))
    torch = sys.modules.get("torch")  # a value made without it holds none of its tensors
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


def udim_number(column: int, row: int) -> int:
    """The number of a texture set's tile: 1001 is the left bottom one."""
    return 1001 + column + 10 * row
