"""Request for a rectangle of a field as files, the field that it opens, and its output plan."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from matcap.brdf.stated import NormalStyle
from matcap.errors import UsageError
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.field.plane import Period, Rectangle, check_seed
from matcap.files import settings as values
from matcap.files.names import Progress, ignore_progress
from matcap.files.settings import CheckedSettings, setting

if TYPE_CHECKING:
    from matcap.field.field import DeviceName
    from matcap.field.material import Material
    from matcap.files.settings import Size


# Request for a rectangle of a material's field as files, and how it is computed.
#
# Read next: plan.py (the field, and which files), stream.py (how they are written).

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
    mipmap: bool = setting(False, option="mip", group="Output")
    """Mip-mapped EXR files."""
    png: bool = setting(False, group="Output")
    """Also write 16-bit PNGs."""
    preview: bool = setting(True, group="Output")
    """Also write NAME_preview.png: about a megapixel, lit from the top, with the seam marked if the
    maps repeat."""
    normal: NormalStyle = setting("gl", words=("gl", "dx"), group="Output")
    """Normals with +Y up (gl) or down (dx)."""
    device: DeviceName = setting("auto", words=("auto", "cpu", "cuda"), group="Advanced")
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

    workers: int = setting(
        1, least=1, most=1024, short="-j", otherwise="one a core", group="Advanced"
    )
    """Processes (threads for a few blocks, and on CUDA); their number changes no bit."""
    scheduler: str | None = setting(None, metavar="tcp://HOST:PORT", group="Advanced")
    """Send blocks to this dask scheduler."""
    resume: bool = setting(False, group="Advanced")
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
