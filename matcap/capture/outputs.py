"""Everything that one captured photograph leaves on disk, written together."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.brdf.folder import PIECE, SETUP, MapSetInfo, mapset_bytes, mapset_files, write_mapset
from matcap.brdf.stated import NormalStyle
from matcap.errors import UsageError
from matcap.example.exemplar import CHANNELS
from matcap.export.targets import check_targets, export_bytes, export_mapset
from matcap.files.exr import write_exr_channels
from matcap.files.staging import staged

if TYPE_CHECKING:
    from matcap.capture.piece.find import FoundPiece
    from matcap.capture.result import CaptureResult
    from matcap.flash.geometry import FlashSetup

PREVIEW, REPORT = "preview.png", "report.json"

_STEP = 16  # texels: the least alignment that a material has
_BESIDES = 50_000_000  # material, preview and report, generously


@dataclass(frozen=True)
class OutputSettings:
    """What is written beside the material.

    Attributes:
        size: (width, height) of the first map set in texels.
        seed: its realisation.
        png: 16-bit PNGs beside the EXR files.
        normal: "gl" or "dx".
        tile: the map set repeats without a seam; both sides are multiples of 16 then. None
            for wherever they are, as repeats() tells.
        targets: what else the map set is written for, each into a folder of its name.

    Raises:
        UsageError: the size cannot tile.
    """

    size: tuple[int, int] = (1024, 1024)
    seed: int = 0
    png: bool = False
    normal: NormalStyle = "gl"
    tile: bool | None = None
    targets: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        width, height = self.size
        if self.tile and (width % _STEP or height % _STEP):
            raise UsageError(
                f"{width}x{height} cannot tile",
                where="size",
                remedy=f"give sides that are multiples of {_STEP}",
            )

    def repeats(self, alignment: int) -> bool:
        """Whether the map set of a material of this alignment repeats without a seam."""
        fits = all(side % alignment == 0 for side in self.size)
        return fits if self.tile is None else self.tile

    @staticmethod
    def known_targets(names: Sequence[str], where: str = "--export") -> tuple[str, ...]:
        """Targets by name, each once.

        Raises:
            UsageError: there is no such target.
        """
        return check_targets(names, where)

    @property
    def room(self) -> int:
        """Bytes of disk that the outputs take at most."""
        exports = len(self.targets) * export_bytes(*self.size)
        return mapset_bytes(*self.size, png=self.png) + exports + _BESIDES


def write_outputs(result: CaptureResult, folder: Path, settings: OutputSettings) -> Path:
    """Write material, first map set, preview.png and report.json into a folder, all or none.

    Exports to other programs come after them, each all or none.

    Args:
        result: of capture_photo.
        folder: made when missing; the material and its maps are called as it is.
        settings: what to write.

    Returns:
        The material's path.

    Raises:
        MatcapError: a full disk, an unwritable folder.
    """
    from matcap.capture.preview import write_preview
    from matcap.capture.report import write_report

    name = folder.name
    older = [*mapset_files(name), *_piece_files(name)]
    # The sheet and its verdict take as long as all the rest, and one thread most of the time. The
    # pool is left first, and what it wrote is published then.
    with staged(folder, replacing=older) as stage, ThreadPoolExecutor(1) as pool:
        written = pool.submit(_write_material, result, stage, name, settings)
        write_preview(result, stage / PREVIEW)
        write_report(result, stage / REPORT)
        written.result()
    for target in settings.targets:
        export_mapset(folder / f"{name}.json", target)
    return folder / f"{name}.matcap"


def _write_material(
    result: CaptureResult, stage: Path, name: str, settings: OutputSettings
) -> None:
    """The material, its first map set and, if asked for, the photographed piece."""
    material = result.material
    period = settings.size if settings.repeats(material.alignment) else None
    maps = material.maps(*settings.size, seed=settings.seed, period=period)
    info = MapSetInfo(name, settings.seed, provenance=dict(material.provenance))
    write_mapset(maps, stage, info, png=settings.png, normal=settings.normal)
    material.save(stage / f"{name}.matcap")
    if result.found is not None and result.settings.aligned:
        _write_piece(result.found, material.setup, stage, name, settings)


def no_repeat(size: tuple[int, int], alignment: int) -> str:
    """What is said of maps that have a seam."""
    width, height = size
    return (
        f"Maps of {width}x{height} do not repeat: there is a seam where they meet themselves; "
        f"sides that are multiples of {alignment} have none."
    )


def output_files(name: str) -> list[str]:
    """Names of all the files that write_outputs leaves in a folder of this name, but exports."""
    from matcap.capture.report import CURVE

    return [f"{name}.matcap", PREVIEW, REPORT, CURVE, *mapset_files(name)]


def _write_piece(
    found: FoundPiece, setup: FlashSetup, stage: Path, name: str, settings: OutputSettings
) -> None:
    """Maps of the photographed piece, and how far each is trusted."""
    from matcap.capture.piece.find import piece_maps

    exemplar = found.exemplar
    about: dict[str, Any] = {"of": "the photographed piece", "error": found.error}
    if found.framed is exemplar:  # else its middle is not the photograph's
        about[SETUP] = asdict(setup)
    info = MapSetInfo(name + PIECE, None, provenance=about)
    write_mapset(piece_maps(exemplar), stage, info, png=settings.png, normal=settings.normal)
    trusted = dict(zip(CHANNELS, exemplar.confidence, strict=True))
    write_exr_channels(stage / _confidence_file(name), trusted)


def _piece_files(name: str) -> list[str]:
    return [*mapset_files(name + PIECE), _confidence_file(name)]


def _confidence_file(name: str) -> str:
    return f"{name}{PIECE}_confidence.exr"
