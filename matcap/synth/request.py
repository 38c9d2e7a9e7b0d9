"""A request for a rectangle of a material's field as files, and the workers for it.

Read next: fields.py (the field), plan.py (which files), stream.py (how they are written).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from matcap.errors import UsageError
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.field.plane import Period, Rectangle, check_seed
from matcap.files import values
from matcap.files.progress import Progress, nobody
from matcap.files.settings import check_settings, setting

if TYPE_CHECKING:
    from matcap.brdf.stated import NormalStyle
    from matcap.field.device import DeviceName
    from matcap.field.material import Material
    from matcap.synth.precision import Precision

_ADDRESS = re.compile(r"[a-z]+://\S+|[^\s/:]+:\d{1,5}")


@dataclass(frozen=True)
class Growth:
    """What a material grows into."""

    material: Material | Path
    """The other one, or its file."""
    mask: Path
    """A grey picture; where it is white the other one is."""
    over: Rectangle | None = None
    """The rectangle that the mask is stretched over, or None for all that is written."""


@dataclass(frozen=True)
class SynthRequest:
    """A rectangle of a material's field, as files.

    Raises:
        UsageError: a seed, word or number that there is not.
    """

    material: Material | Path
    """To make more of, or its file."""
    area: Rectangle
    """Of the one map set, or of a texture set's left top tile, in texels of the field; not read
    where `tile` is "piece"."""
    seed: int = setting(0, parse=values.seed, metavar="SEED")
    """Which piece of the material, in [-2^63, 2^63)."""
    name: str = ""
    """Of the files; the material's unless given."""
    read: ReadOptions = AS_IT_IS
    """Generator, variety and adjustments, as recorded in the sidecar's provenance."""
    tile: Literal["both", "x", "y", "piece"] | None = setting(
        None, words=("both", "x", "y", "piece")
    )
    """Repeat exactly along both axes, or along x or y alone; piece: the photographed piece itself,
    made to repeat, at about its own size."""
    udim: tuple[int, int] | None = setting(None, metavar="CxR", parse=values.sides_of)
    """A texture set of C columns (at most 10) and R rows (at most 900), each tile of the given
    size."""
    single: bool = setting(False)
    """All maps in one EXR file."""
    mipmap: bool = setting(False, option="mip")
    """Mip-mapped EXR files, as texture readers like them."""
    png: bool = setting(False)
    """16-bit PNGs beside the EXR files."""
    normal: NormalStyle = setting("gl", words=("gl", "dx"))
    """Normals with +Y up (gl) or down (dx)."""
    growth: Growth | None = None
    """What it grows into."""
    precision: Precision = setting("fp32", words=("fp32", "bf16", "auto"))
    """Of the network. auto: as much bf16 as changes no map by half an 8-bit step."""
    device: DeviceName = setting("auto", words=("auto", "cpu", "cuda"))
    """Where the network computes. auto: a CUDA device where PyTorch sees one."""

    def __post_init__(self) -> None:
        check_settings(self)
        check_seed(self.seed)

    @property
    def whole(self) -> Rectangle:
        """All of the texture set, or of the one map set."""
        columns, rows = self.udim or (1, 1)
        area = self.area
        return Rectangle(area.x, area.y, area.width * columns, area.height * rows)

    @property
    def period(self) -> Period | None:
        """What repeats: the whole of what is written."""
        if self.tile is None:
            return None
        area = self.whole
        return None if self.tile == "y" else area.width, None if self.tile == "x" else area.height


@dataclass(frozen=True)
class SynthProgress(Progress):
    """How far a run has come."""

    rate: float = 0.0
    """Texels a second, what was resumed left out."""
    resumed: float = 0.0
    """Share of the whole that was there before."""


@dataclass(frozen=True)
class Work:
    """Who makes it."""

    workers: int = setting(1, least=1, most=1024, short="-j", otherwise="one a core")
    """Processes (threads for a few blocks, and on CUDA); their number changes no bit."""
    scheduler: str | None = setting(None, metavar="tcp://HOST:PORT")
    """Send blocks to this dask scheduler."""
    resume: bool = setting(False)
    """Go on with what an interrupted run of the same request left."""
    progress: Callable[[SynthProgress], None] = nobody
    """Called after every block."""
    overwrite: bool = True
    """Replace what stands in the way, another map set of the same name too."""
    inputs: tuple[Path, ...] = ()
    """Files that are read, and never replaced."""

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
