"""report.json and the other files of a capture: all of them or none, and what may be overwritten.

report.json: input, settings, errors, verdict and versions of a capture. Its keys are
described in report.schema.json.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.brdf.folder import PIECE, SETUP, MapSetInfo, mapset_files, preview_name, write_mapset
from matcap.capture.settings import CaptureSettings, OutputSettings, RunStatus, resolve
from matcap.errors import MatcapError
from matcap.example.example import summary
from matcap.example.exemplar import CHANNELS
from matcap.files.exr import write_exr_channels
from matcap.files.names import MAKER_VERSION, read_document
from matcap.files.output import Output
from matcap.files.threads import at_once
from matcap.photo.checks import Rating

if TYPE_CHECKING:
    from matcap.capture.exemplar.estimate import ExemplarEstimate
    from matcap.capture.result import CaptureResult, Tuning
    from matcap.flash.geometry import FlashSetup

PREVIEW, REPORT = "preview.png", "report.json"


def files_written(names: Sequence[str]) -> set[str]:
    """Which of a folder's files, by `names`, are of a capture, a map set or an export in it."""
    documents = [Path(name).stem for name in names if name.endswith(".json")]
    if not documents:
        return set()
    from matcap.export.targets import TARGETS  # takes a second

    written = {file for name in documents for file in (*mapset_files(name), preview_name(name))}
    for name, _, target in (document.rpartition("_") for document in documents):
        if target in TARGETS:
            written |= {file for file in names if file.removeprefix("T_").startswith(f"{name}_")}
    return written | ({PREVIEW} if REPORT in names else set())


def write_outputs(result: CaptureResult, folder: Path, settings: OutputSettings) -> Path:
    """Write material, first map set, preview.png and report.json into a folder, all or none.

    Exports to other programs come after them, each all or none.

    Args:
        result: of capture_photo.
        folder: created if missing; its name is that of the material and the maps.

    Returns:
        Path of the .matcap file.

    Raises:
        MatcapError: the disk is full, or the folder cannot be written.
    """
    from matcap.capture.preview import write_preview

    name = folder.name
    older = [
        *mapset_files(name),
        preview_name(name),
        *mapset_files(name + PIECE),
        _confidence_file(name),
        "error.png",  # of earlier versions
    ]
    with Output(folder, older).stage() as stage:
        # Drawing the preview takes as long as writing the rest.
        at_once(
            partial(write_preview, result, stage / PREVIEW),
            partial(_write_material, result, stage, name, settings),
        )
        write_report(result, stage / REPORT)
    if settings.targets or settings.maps:
        from matcap.export.targets import engine_maps, export_mapset
    if settings.maps:
        options = engine_maps(settings.maps, settings.normal)
        export_mapset(folder / f"{name}.json", "substance", options, "maps")
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
    del maps  # 50 MB of 1024 texels, with what saving takes
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
    from matcap.capture.exemplar.predict import map_set_of

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


# Reading report.json; report.schema.json is its JSON Schema.
#
# Format 1 had other names for some entries.

FORMAT, VERSION = "matcap report", 2
# Entries that matcap reads and that format 1 had under another name: where ("*" is every member),
# old and new.
_RENAMED = (
    ("", "several", "multi_view"),
    ("verdict.causes.*", "says", "message"),
    ("verdict.checks.*", "says", "message"),
)


def read_report(file: Path) -> dict[str, Any] | None:
    """A capture's report as format 2; None if the file is missing, damaged or of a later format."""
    report = read_document(file, FORMAT)
    version = 1 if report is None else report.get("version", 1)
    if report is None or version not in (1, VERSION):
        return None
    for where, old, new in _RENAMED if version == 1 else ():
        for entry in _members(report, where.split(".") if where else []):
            if old in entry:
                entry[new] = entry.pop(old)
    return report | {"version": VERSION}


def _members(document: object, path: list[str]) -> Iterator[dict[str, Any]]:
    """The objects at a path, as far as it is there."""
    if not path:
        if isinstance(document, dict):
            yield document
    elif path[0] == "*":
        inside = document.values() if isinstance(document, dict) else document
        for one in inside if not isinstance(inside, str) and hasattr(inside, "__iter__") else ():
            yield from _members(one, path[1:])
    elif isinstance(document, dict):
        yield from _members(document.get(path[0]), path[1:])


_LIBRARIES = ("torch", "numpy", "opencv-contrib-python-headless", "rawpy", "OpenEXR")


def write_report(result: CaptureResult, path: Path) -> None:
    """Write the report of a capture.

    Raises:
        MatcapError: the file cannot be written.
    """
    text = json.dumps(_finite(report(result)), indent=2, default=str, allow_nan=False)
    with Output(path.parent).stage() as stage:
        (stage / path.name).write_text(text + "\n")


def report(result: CaptureResult) -> dict[str, Any]:
    """The report as plain data. Angles in degrees, times in seconds, lengths in plane units."""
    setup, photo, several = result.material.setup, result.photo, result.several
    profile = result.measurements.profile
    extent = [several.mosaic.summary()] if several and several.mosaic.margins.any else []
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": result.material.name,
        "interrupted": result.status is RunStatus.INTERRUPTED,
        "verdict": result.verdict.document(),
        "highlight": profile and profile.document(),
        "error": result.errors,
        "warnings": list(warnings(result)),
        "notes": [*photo.notes, *extent, *level_notes(result), *_setting_notes(result)],
        "photograph": {
            "name": photo.name,
            "path": None if photo.path is None else str(photo.path),
            "size": list(photo.original_size),
            "size_used": [photo.pixels.shape[1], photo.pixels.shape[0]],
            "turned": photo.turned,
            "radiometric": photo.radiometric,
            "flash_fired": photo.flash_fired,
            "gain_map_applied": photo.gain_map_applied,
            "clipped_share": photo.clipped_share,
            "headroom": photo.headroom if math.isfinite(photo.headroom) else None,
        },
        "camera": {
            "fov_degrees": setup.fov,
            "fov_source": photo.fov_source,
            "distance": setup.distance,
            "tilt_degrees": [math.degrees(angle) for angle in setup.tilt],
            "tilt_sources": result.tilt_sources,
            "flash_offset": list(setup.offset),
            "flash_intensity": list(setup.intensity),
            "vignetting": setup.vignetting,
            "vignetting_quartic": setup.vignetting_quartic,
            "vignetting_centre": list(setup.vignetting_centre),
            "vignetting_colour": list(setup.vignetting_colour),
            "tone_curve": photo.tone and asdict(photo.tone),
        },
        "texel_size": result.material.texel_size,
        "settings": result.settings.named(),
        "effort": _effort(result),
        "seconds": sum(result.stage_seconds.values()),
        "stage_seconds": dict(result.stage_seconds),
        "tuning": _tuning(result.tuning),
        "generators": result.choice and result.choice.document(),
        "latent": _latent(result),
        "exemplar": _exemplar(result),
        "multi_view": several and several.document(),
        "provenance": result.material.provenance,
        "versions": {
            "matcap": MAKER_VERSION,
            "python": platform.python_version(),
            "platform": platform.platform(),
            **{name: version(name) for name in _LIBRARIES},
        },
    }


def _effort(result: CaptureResult) -> dict[str, Any]:
    effort = asdict(result.effort)
    del effort["decoder_steps"]
    if result.tuning is None and result.settings.generator != "decoder":
        del effort["places"], effort["matched"]
    else:
        effort["windows_per_step"] = effort.pop("places")
    return effort


def _tuning(tuning: Tuning | None) -> dict[str, Any] | None:
    if tuning is None:
        return None
    history = tuning.history
    return {
        "drawing": tuning.drawing,
        "error": history[-1][2] if history else None,
        "self_difference": tuning.self_difference,
        "relative_error": tuning.relative_error,
        "error_over_time": [
            {"seconds": seconds, "step": step, "error": error} for seconds, step, error in history
        ],
    }


def _latent(result: CaptureResult) -> dict[str, Any] | None:
    latent = result.material.latent
    if latent is None:
        return None
    return {"prior": latent.prior, "code": [round(v, 4) for v in latent.code.tolist()]}


def _exemplar(result: CaptureResult) -> dict[str, Any] | None:
    estimate = result.estimate
    if estimate is None:
        return None
    spectrum = estimate.relief_spectrum
    return {
        "error": estimate.error,
        "left_out": estimate.example.index.left_out,
        "variety": estimate.example.variety,
        "patches": summary(estimate.example).patches_text(),
        "relief_spectrum": spectrum and spectrum.document(),
        "level": estimate.level,
        "level_deviation": estimate.level_deviation,
        "confidence": estimate.mean_confidence(result.photo.kept_share),
        "specular_channels": len(estimate.exemplar.specular),
        "highlight_residue": result.measurements.exemplar.residue,
    }


def warnings(result: CaptureResult) -> Iterable[str]:
    """Sentences on what may reduce the quality of the result, each with a remedy."""
    if result.status is RunStatus.INTERRUPTED:
        yield "Interrupted: this is the best so far; run it again for a better result."
    # The verdict checks the flash by the light; a warning is due if the metadata deny it.
    denied = ("flash",) if result.photo.flash_fired is False else ()
    shot = (result.measurements.photograph[key] for key in (*denied, "clipped", "tilt"))
    yield from (finding.line() for finding in shot if finding.rating is not Rating.GOOD)
    yield from set_warnings(result)
    if result.estimate is not None and result.estimate.relief_spectrum is None:
        yield (
            "The photograph is too small, or too much of it is clipped or masked, to measure the "
            "depth of its relief: it is the network's estimate. Photograph again a stop darker, "
            "or from further away."
        )


def set_warnings(result: CaptureResult) -> Iterable[str]:
    """Sentences on several photographs: left out, uncertain, or in vain with --union."""
    several = result.several
    if several is None:
        return
    for one in several.left_out:
        yield f"{one.name} was left out: {one.why}."
    if uncertain := several.warning():
        yield uncertain
    if several.mosaic.margins.any:
        if limited := several.mosaic.warning():
            yield limited
    elif result.settings.union and len(several.views) > 1:
        yield (
            "The other photographs show hardly more than the first one, so --union makes the maps "
            "no larger. Move the phone farther from one to the next, by up to half a picture."
        )


def level_notes(result: CaptureResult) -> Iterable[str]:
    """A sentence on a dielectric's mean albedo and its standard deviation, where not given."""
    estimate = result.estimate
    if estimate is not None and estimate.level_deviation:
        yield (
            f"Mean albedo {estimate.level:.2g}, uncertain by a factor of "
            f"{math.exp(estimate.level_deviation):.1f}: one photograph shows it only against the "
            "highlight. --albedo states it."
        )


def _setting_notes(result: CaptureResult) -> Iterable[str]:
    """Sentences on settings that act differently from what their names suggest."""
    settings, effort = result.settings, result.effort
    limited = settings.time_limit is not None
    if limited and settings.generator != "decoder":
        yield "With a time limit, the preset has no effect: the limit determines the texels."
    elif limited and settings.steps is None:
        yield (
            "With a time limit, the preset has no effect: at most "
            f"{effort.steps} steps. Give --steps for another number."
        )
    if settings.width_cm is None:
        yield (
            "The size of the sample is unknown: heights are in units of half the photograph's long "
            "side. Give --width-cm, the length that this side shows."
        )


def _finite(value: object) -> object:
    """The same data with null in place of NaN and infinity, which JSON lacks."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value


# Overwrite rule of batches: a capture is not replaced by one of less effort.


def refuse_to_replace_longer_capture(
    folder: Path, settings: CaptureSettings, photographs: int
) -> None:
    """Raise if a folder has a capture of more photographs, texels or steps than a new one.

    Raises:
        MatcapError: states the old effort and names --overwrite.
    """
    old = read_report(folder / REPORT)
    if old is None or old.get("interrupted"):
        return
    before = len((old.get("multi_view") or {}).get("photographs", ())) or 1
    spent, effort = old.get("effort", {}), resolve(settings)
    # `effort` may hold the preset's detail, so that `settings` comes first.
    detail = old.get("settings", {}).get("detail") or spent.get("detail", 0)
    if before > photographs:
        earlier = f"one of {before} photographs"
    elif detail > effort.detail or spent.get("steps", 0) > effort.steps:
        earlier = f"a longer one, of preset {spent.get('preset')}"
    else:
        return
    raise MatcapError.at(
        folder,
        f"the folder has an earlier capture ({earlier})",
        "choose another folder with -o, or give --overwrite",
    )
