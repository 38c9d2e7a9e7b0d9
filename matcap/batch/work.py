"""A worker's job: the photographs of one sample to its folder, written completely or not at all."""

from __future__ import annotations

import errno
import os
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from matcap.batch.record import write_record
from matcap.batch.settings import BatchSettings
from matcap.batch.workspace import Run
from matcap.errors import MatcapError
from matcap.files.memory import keep_memory
from matcap.files.output import write_error
from matcap.files.progress import OnProgress, Progress
from matcap.photo.calibrate import Calibration, calibrated

if TYPE_CHECKING:
    from matcap.capture.result import CaptureResult
    from matcap.capture.settings import CaptureSettings
    from matcap.photo.inspect import Inspection

Fault = Literal["photograph", "memory", "disk", "crash"]
_THUMBNAIL = 192  # pixels along the long side
_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})


@dataclass(frozen=True)
class BatchJob:
    """One sample to capture."""

    name: str
    """Name of the material."""
    photos: tuple[Path, ...]
    """Photographs of the sample."""
    identity: str
    """Hash of the inputs, for the record."""
    settings: BatchSettings
    """Settings of the batch."""
    run: Run
    """Workspace."""
    detail: int
    """Texels across; less than in the settings after memory ran out."""
    alone: bool = False
    """Run while no other worker does."""
    card: Calibration | None = None
    """Calibration from a card's photograph, or None."""


@dataclass(frozen=True)
class Failure:
    """Why a capture failed."""

    kind: Fault
    """"photograph" fails every time; the others may pass."""
    sentence: str
    """The message: where, what and remedy."""


def do_job(job: BatchJob, on_progress: OnProgress) -> dict[str, Any] | Failure:
    """Capture a sample and publish its folder; returns the record without thumbnails.

    Any error is returned as a Failure.
    """
    try:
        return _do(job, on_progress)
    except MemoryError:
        return Failure("memory", _no_memory(job))
    except MatcapError as error:
        return Failure(_fault(error), str(error))
    except OSError as error:
        failure = write_error(job.run.out / job.name, error)
        return Failure("disk" if error.errno in _DISK else "crash", str(failure))
    except Exception as error:
        if _is_no_memory(error):
            return Failure("memory", _no_memory(job))
        said = f"{job.photos[0]}: internal error ({type(error).__name__}: {error})"
        return Failure("crash", f"{said}; report it, with the photograph.")


def _fault(error: MatcapError) -> Fault:
    """The kind of a failure, by the error's cause."""
    cause = error.__cause__
    if isinstance(cause, MemoryError):
        return "memory"
    if isinstance(cause, OSError) and cause.errno is not None:  # Pillow raises some without errno
        return "disk" if cause.errno in _DISK else "crash"
    return "photograph"


def _do(job: BatchJob, on_progress: OnProgress) -> dict[str, Any]:
    from matcap.capture.bracket import find_brackets
    from matcap.capture.inspection import photograph_quality
    from matcap.capture.outputs import write_outputs
    from matcap.capture.pipeline import capture_photo, read_exposures
    from matcap.photo.inspect import inspect_photo

    started = time.perf_counter()
    on_progress(Progress("reading", 0.0))
    settings = job.settings
    chosen = measured(settings.capture, job.card)
    if job.detail != chosen.most_detail:
        chosen = replace(chosen, detail=job.detail)
    photos = []
    groups = find_brackets(job.photos, fov=chosen.fov)
    for group in groups:
        photo = read_exposures(group, chosen, several=len(groups) > 1)
        photos.append(photo if job.card is None else calibrated(photo, job.card))

    result = capture_photo(photos[0], chosen, on_progress, others=photos[1:])
    on_progress(Progress("writing", 0.95))
    # Findings use the capture's tilt, so that report and record agree.
    first = inspect_photo(photos[0], result.material.setup.tilt)
    looked_at = [first, *map(photograph_quality, photos[1:])]
    stage = job.run.stage(job.name)
    write_outputs(result, stage, settings.outputs)
    about = _about(job, looked_at, result)
    about["seconds"] = round(time.perf_counter() - started, 3)
    about["peak_bytes"] = _peak_bytes()
    write_record(stage, {**about, "thumbnails": _thumbnails(result)})
    job.run.publish(stage)
    return about


def measured(settings: CaptureSettings, card: Calibration | None) -> CaptureSettings:
    """Settings with the width that the card's chessboard measured, unless a width is given."""
    if settings.width_cm is not None or card is None or card.millimetres_per_unit is None:
        return settings
    return replace(settings, width_cm=2.0 * card.millimetres_per_unit / 10.0)


def _about(job: BatchJob, looked_at: Sequence[Inspection], result: CaptureResult) -> dict[str, Any]:
    """The record of a material, for the index."""
    from matcap.capture.report import warnings

    verdict = result.verdict
    said = [*([] if verdict.rating.value == "good" else [f"Verdict {verdict.sentence()}"])]
    said += warnings(result)
    if job.detail != job.settings.capture.most_detail:
        said.append(f"Memory ran out; captured again at a detail of {job.detail} texels across.")
    for inspection in looked_at:
        of = f"{inspection.name}: " if len(looked_at) > 1 else ""
        doubts = [f.line() for f in inspection.findings if not f.rating.fit]
        said += [f"{of}{doubt}" for doubt in doubts]
    tilt = result.material.setup.tilt
    return {
        "name": job.name,
        "identity": job.identity,
        "photographs": [str(path) for path in job.photos],
        "detail": round(2.0 / result.material.texel_size),
        "verdict": {"rating": verdict.rating.value, "severity": round(verdict.severity, 3)},
        "error": result.errors,
        "tilt_degrees": [round(angle * 57.29577951, 3) for angle in tilt],
        "clipped": round(result.photo.clipped_share, 5),
        "doubtful": not (verdict.fit and all(one.rating.fit for one in looked_at)),
        "warnings": list(dict.fromkeys(said)),
        "notes": list(result.photo.remarks),
        "inspection": [inspection.document() for inspection in looked_at],
        "albedo": "absolute" if result.photo.flash_intensity is not None else "relative",
        "card": job.card.document() if job.card else None,
        "stage_seconds": {name: round(s, 3) for name, s in result.stage_seconds.items()},
        "steps": result.effort.steps,
    }


def _thumbnails(result: CaptureResult) -> dict[str, str]:
    """The preview's panels as small JPEGs, base64 by label, for the index page."""
    import base64
    from io import BytesIO

    from matcap.capture.preview import panels

    pictures = {}
    for panel in panels(result):
        height, width = panel.values.shape[:2]
        scale = min(1.0, _THUMBNAIL / max(height, width))
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        jpeg = BytesIO()
        panel.resized(size).save(jpeg, "JPEG", quality=80)
        pictures[panel.label] = base64.b64encode(jpeg.getvalue()).decode()
    return pictures


def _no_memory(job: BatchJob) -> str:
    return (
        f"{job.photos[0]}: not enough memory for a detail of {job.detail}; "
        "close other programs, or lower --detail, --size or -j."
    )


def _is_no_memory(error: Exception) -> bool:
    """Whether memory ran out: torch raises RuntimeError for it, OpenCV cv2.error."""
    text = str(error).lower()
    return any(
        words in text for words in ("can't allocate memory", "out of memory", "insufficient memory")
    )


def _peak_bytes() -> int:
    """Peak resident memory of this process."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def settle_threads() -> None:
    """Limit the libraries to one thread: workers use all cores, and results do not depend on them.

    Also keeps freed memory for the process's next capture.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    import cv2
    import torch

    keep_memory()

    torch.set_num_threads(1)
    cv2.setNumThreads(1)
