"""Writing the outputs of a capture into its folder, all or none."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.brdf.folder import PIECE, SETUP, MapSetInfo, mapset_files, preview_name, write_mapset
from matcap.capture.settings import OutputSettings
from matcap.example.exemplar import CHANNELS
from matcap.files.exr import write_exr_channels
from matcap.files.output import Output

if TYPE_CHECKING:
    from matcap.capture.exemplar.estimate import ExemplarEstimate
    from matcap.capture.result import CaptureResult
    from matcap.flash.geometry import FlashSetup

PREVIEW, REPORT = "preview.png", "report.json"


def files_written(names: Sequence[str]) -> set[str]:
    """Which of a folder's files, by their `names`, are of a capture or a map set in it."""
    sets = [Path(name).stem for name in names if name.endswith(".json")]
    written = {file for name in sets for file in (*mapset_files(name), preview_name(name))}
    return written | ({PREVIEW} if REPORT in names else set())


def write_outputs(result: CaptureResult, folder: Path, settings: OutputSettings) -> Path:
    """Write material, first map set, preview.png and report.json into a folder, all or none.

    Exports to other programs come after them, each all or none.

    Args:
        result: of capture_photo.
        folder: created if missing; its name is that of the material and the maps.
        settings: what to write.

    Returns:
        Path of the .matcap file.

    Raises:
        MatcapError: the disk is full, or the folder cannot be written.
    """
    from matcap.capture.preview import write_preview
    from matcap.capture.report import write_report

    name = folder.name
    older = [
        *mapset_files(name),
        preview_name(name),
        *mapset_files(name + PIECE),
        _confidence_file(name),
        "error.png",  # of earlier versions
    ]
    # Drawing the preview takes as long as writing the rest, mostly on one thread: do both at once.
    # The pool exits first, then the stage publishes all files.
    with Output(folder, older).stage() as stage, ThreadPoolExecutor(1) as pool:
        written = pool.submit(_write_material, result, stage, name, settings)
        write_preview(result, stage / PREVIEW)
        write_report(result, stage / REPORT)
        written.result()
    if settings.targets:
        from matcap.export.targets import export_mapset
    for target in settings.targets:
        export_mapset(folder / f"{name}.json", target)
    return folder / f"{name}.matcap"


def _write_material(
    result: CaptureResult, stage: Path, name: str, settings: OutputSettings
) -> None:
    """Write the material, its first map set and, with `aligned`, the exemplar's maps."""
    material = result.material
    period = settings.size if settings.repeats(material.alignment) else None
    maps = material.maps(*settings.size, seed=settings.seed, period=period)
    info = MapSetInfo(name, settings.seed, provenance=dict(material.provenance))
    write_mapset(maps, stage, info, png=settings.png, normal=settings.normal)
    material.save(stage / f"{name}.matcap")
    if result.estimate is not None and result.settings.aligned:
        _write_piece(result.estimate, material.setup, stage, name, settings)


def no_repeat(size: tuple[int, int], alignment: int) -> str:
    """Message that maps of this size (width, height) show a seam when tiled."""
    width, height = size
    return (
        f"Maps of {width}x{height} do not repeat: tiled, they show a seam. For seamless maps, "
        f"choose sides that are multiples of {alignment}."
    )


def output_files(name: str) -> list[str]:
    """Names of the files that write_outputs writes into a folder of this name, without exports;
    error.png is of earlier versions.
    """
    return [f"{name}.matcap", PREVIEW, REPORT, *mapset_files(name), "error.png"]


def _write_piece(
    estimate: ExemplarEstimate, setup: FlashSetup, stage: Path, name: str, settings: OutputSettings
) -> None:
    """Write the exemplar's maps and their confidence, in [0, 1] per map and texel."""
    from matcap.capture.exemplar.estimate import map_set_of

    exemplar = estimate.exemplar
    about: dict[str, Any] = {"of": "the photographed piece", "error": estimate.error}
    # Else the setup's origin, the photograph's centre, is not the exemplar's.
    if estimate.first_rectangle is exemplar:
        about[SETUP] = asdict(setup)
    info = MapSetInfo(name + PIECE, None, provenance=about)
    write_mapset(map_set_of(exemplar), stage, info, png=settings.png, normal=settings.normal)
    confidence = dict(zip(CHANNELS, exemplar.confidence, strict=True))
    write_exr_channels(stage / _confidence_file(name), confidence)


def _confidence_file(name: str) -> str:
    return f"{name}{PIECE}_confidence.exr"
