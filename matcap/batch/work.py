"""A worker's job: one sample to its folder, all or nothing; memory, claims, records, states."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from filelock import FileLock, Timeout

from matcap.batch.samples import WORKSPACE, BatchSettings, Policy, ShotSample, identity
from matcap.capture.report import refuse_to_replace_longer_capture
from matcap.capture.settings import UNION_TIMES
from matcap.errors import MatcapError
from matcap.files.names import OnProgress, Progress, read_document
from matcap.files.output import HIDDEN, Output, write_error
from matcap.files.process import cores, free_bytes, keep_memory
from matcap.files.threads import compute_alone
from matcap.photo.calibrate import Calibration, calibrated

if TYPE_CHECKING:
    from matcap.capture.result import CaptureResult
    from matcap.capture.settings import CaptureSettings
    from matcap.photo.inspect import Inspection


# The manifest in each material's folder: the hash of its inputs, and its files with their sizes.
#
# A material is done if its record has the requested identity and all files have their sizes. The
# record is written after all files, each of which is synced to disk before it gets its final name.

FILE = "matcap-batch.json"
FORMAT = "matcap batch record"
VERSION = 1  # of the file
_MOST_BYTES = 20_000_000  # thumbnails included


@contextmanager
def recorded(folder: Path, about: dict[str, Any]) -> Iterator[None]:
    """Context that writes a material's files into its folder; records them on exit.

    The files of an earlier record that are not written again are removed; others stay.

    Args:
        folder: of the material; created if missing.
        about: JSON entries of the record, `identity` among them, when the context ends.

    Raises:
        MatcapError: the folder cannot be written.
    """
    older, before = read_record(folder) or {"files": {}}, _files(folder)
    (folder / FILE).unlink(missing_ok=True)
    yield
    # Whatever replaces a file is another one.
    files = {
        name: stat.st_size
        for name, stat in _files(folder).items()
        if name not in before or before[name].st_ino != stat.st_ino
    }
    for name in older["files"].keys() - files.keys():
        (folder / name).unlink(missing_ok=True)
    document = {"format": FORMAT, "version": VERSION, **about, "files": files}
    with Output.file(folder / FILE) as file:
        file.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _files(folder: Path) -> dict[str, os.stat_result]:
    """The files in a folder by their path in it, hidden ones apart."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file())
    named = {file.relative_to(folder): file for file in files}
    return {
        path.as_posix(): file.stat()
        for path, file in named.items()
        if not any(part.startswith(".") for part in path.parts)
    }


def read_record(folder: Path) -> dict[str, Any] | None:
    """The record of a material's folder; None if there is none, or it cannot be read."""
    file = folder / FILE
    document = read_document(file, FORMAT) if (_size(file) or 0) <= _MOST_BYTES else None
    if document is None or document.get("version") != VERSION:
        return None
    return document if isinstance(document.get("files"), dict) else None


def is_done(folder: Path, identity: str) -> bool:
    """Whether a folder holds the complete material of this identity."""
    record = read_record(folder)
    if record is None or record.get("identity") != identity:
        return False
    return all(_size(folder / name) == size for name, size in record["files"].items())


def _size(file: Path) -> int | None:
    try:
        return file.stat().st_size
    except (OSError, ValueError):  # ValueError: a name with a null character
        return None


# Memory of one worker, and the number of workers that fit.
#
# A sum of the libraries, the decoded photograph, a part proportional to the exemplar's texels and
# one to the map set's. Measured on Linux, glibc (command in docs/notes/stability.md).

_LIBRARIES = 1_150_000_000  # bytes, with the optimisation of one window
_BY_PIXEL = {"raw": 22, "other": 12}  # bytes a pixel of the file
_BY_TEXEL = 400  # bytes a texel of the exemplar, detail x 3/4 detail
_BY_MAP_TEXEL = 110  # bytes a texel of the map set
_USUAL_PIXELS = 12_000_000  # assumed where a file cannot be read
_SPARE = 0.85  # share of the free memory that workers may take
_RAW_FORMS = ("RAW", "DNG")


def worker_bytes(settings: BatchSettings, pixels: int, *, raw: bool) -> int:
    """Upper bound of a worker's memory, in bytes.

    Args:
        pixels: of the largest photograph.
        raw: whether that is a RAW file.
    """
    width, height = settings.outputs.size
    detail = settings.capture.most_detail
    return (
        _LIBRARIES
        + _BY_PIXEL["raw" if raw else "other"] * pixels
        + _BY_TEXEL * detail * detail * 3 // 4 * (UNION_TIMES if settings.capture.union else 1)
        + _BY_MAP_TEXEL * width * height
    )


def largest_worker(settings: BatchSettings, photos: Sequence[Path]) -> int:
    """The largest worker_bytes over photographs."""
    sizes = [photo_pixels(photo) for photo in photos] or [(_USUAL_PIXELS, False)]
    return max(worker_bytes(settings, pixels, raw=raw) for pixels, raw in sizes)


def photo_pixels(path: Path) -> tuple[int, bool]:
    """Number of pixels by a file's header, and whether it is RAW; typical values if unreadable."""
    from matcap.files.containers import MOST_PIXELS
    from matcap.files.process import quiet_decoders
    from matcap.photo.load import file_kind

    try:
        with quiet_decoders():
            raw = file_kind(path).value in _RAW_FORMS
            if raw:
                import rawpy

                with rawpy.imread(str(path)) as file:
                    return int(file.sizes.raw_width) * int(file.sizes.raw_height), True
            from PIL import Image

            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # Pillow's on large pictures
                    with Image.open(path) as picture:
                        return picture.width * picture.height, False
            except Image.DecompressionBombError:  # above Pillow's limit
                return MOST_PIXELS, False
    except Exception:
        return _USUAL_PIXELS, path.suffix.lower() not in (".jpg", ".jpeg", ".jpe", ".jfif", ".png")


def pool_size(wanted: int | None, each: int, jobs: int) -> int:
    """Number of workers: `wanted`, else the cores; at most what fits in memory, and `jobs`.

    Args:
        wanted: by the user, or None.
        each: bytes of a worker.
    """
    fit = int(_SPARE * free_bytes()) // max(1, each)
    return max(1, min(wanted or cores(), fit, jobs))


# State of a batch in its output folder.
#
# OUT/leather/                     a material; complete once its record is there
# OUT/.matcap-batch/lock           held by the run that writes here, one at a time
# OUT/.matcap-batch/failed/NAME    a sample that cannot be used, and why
#
# The system releases the lock when a process ends, however it ends.


@contextmanager
def open_run(out: Path) -> Iterator[None]:
    """Hold the lock of an output folder; first clears up after a run that was killed.

    Raises:
        MatcapError: another batch writes into the folder, or it cannot be created or written.
    """
    lock = FileLock(out / WORKSPACE / "lock", timeout=0)
    try:
        (out / WORKSPACE).mkdir(parents=True, exist_ok=True)
        with suppress(NotImplementedError):  # a file system without locks
            lock.acquire()
    except Timeout as error:
        raise MatcapError.at(
            out, "another matcap batch writes into this folder", "wait for it, or give another -o"
        ) from error
    except OSError as error:
        raise write_error(out, error) from error
    for stage in out.glob(f"*/{HIDDEN}*"):
        if stage.name != WORKSPACE:  # of another batch
            shutil.rmtree(stage, ignore_errors=True)
    try:
        yield
    finally:
        lock.release()


def write_failure(out: Path, name: str, about: Mapping[str, Any]) -> None:
    """Record that a sample cannot be used."""
    with Output.file(out / WORKSPACE / "failed" / name) as file:
        file.write_text(json.dumps(dict(about)), encoding="utf-8")


def read_failure(out: Path, name: str) -> dict[str, Any] | None:
    """The record of a sample that could not be used; None without one."""
    return read_document(out / WORKSPACE / "failed" / name)


def forget_failure(out: Path, name: str) -> None:
    """Remove the record of a failure."""
    (out / WORKSPACE / "failed" / name).unlink(missing_ok=True)


# The state of each sample of a batch (to do, done, failed), read from the output files.

EntryState = Literal["todo", "made", "kept", "failed", "left"]


@dataclass
class BatchEntry:
    """A sample and its state, which the batch updates."""

    sample: ShotSample
    """Name and photographs of the sample."""
    identity: str
    """Hash of the material to be made (samples.py); "" if a photograph cannot be read."""
    state: EntryState
    """"todo"; "made" by this run; "kept", done by an earlier one; "failed"; or "left", not begun
    because the batch ended early."""
    reason: str = ""
    """Why it failed or was left."""
    record: dict[str, Any] = field(default_factory=dict)
    """Record of the material; empty if not captured yet."""


def make_plan(
    samples: Sequence[ShotSample],
    out: Path,
    settings: BatchSettings,
    policy: Policy,
    *,
    prior: str,
    card: str = "",
) -> list[BatchEntry]:
    """Determine the state of every sample.

    Args:
        prior: hash of the prior.
        card: hash of the calibration, or "".
    """
    entries = []
    for sample in samples:
        try:
            wanted = identity(sample.photos, settings, prior=prior, card=card)
        except MatcapError as error:
            entries.append(BatchEntry(sample, "", "failed", str(error)))
            continue
        entries.append(BatchEntry(sample, wanted, "todo"))
        _judge(entries[-1], out, settings, policy)
    return entries


def _judge(entry: BatchEntry, out: Path, settings: BatchSettings, policy: Policy) -> None:
    """Update an entry whose material is done, failed before, or would replace a longer capture."""
    folder = out / entry.sample.name
    if not policy.force and is_done(folder, entry.identity):
        entry.state, entry.record = "kept", read_record(folder) or {}
        return
    again = policy.force or policy.retry_failed
    known = None if again else read_failure(out, entry.sample.name)
    if known is not None and known.get("identity") == entry.identity:
        entry.state, entry.reason = "failed", str(known.get("reason", "it failed before"))
        return
    try:
        if not policy.overwrite:
            refuse_to_replace_longer_capture(folder, settings.capture, len(entry.sample.photos))
    except MatcapError as error:
        entry.state, entry.reason, entry.record = "failed", str(error), read_record(folder) or {}


# A worker's job: the photographs of one sample to its folder, written completely or not at all.

Fault = Literal["photograph", "memory", "disk", "crash"]
_THUMBNAIL = 192  # pixels along the long side
_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})


@dataclass(frozen=True)
class BatchJob:
    """One sample to capture."""

    name: str
    photos: tuple[Path, ...]
    identity: str
    """Hash of the inputs, for the record."""
    settings: BatchSettings
    out: Path
    """The output folder of the batch."""
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
    """Capture a sample into its folder; returns the record without thumbnails.

    Any error is returned as a Failure.
    """
    try:
        return _do(job, on_progress)
    except MemoryError:
        return Failure("memory", _no_memory(job))
    except MatcapError as error:
        return Failure(_fault(error), str(error))
    except OSError as error:
        failure = write_error(job.out / job.name, error)
        return Failure("disk" if error.errno in _DISK else "crash", str(failure))
    except Exception as error:
        if _is_no_memory(error):
            return Failure("memory", _no_memory(job))
        message = f"{job.photos[0]}: internal error ({type(error).__name__}: {error})"
        return Failure("crash", f"{message}; report it, with the photograph.")


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
    from matcap.capture.pipeline import capture_photo
    from matcap.capture.report import write_outputs
    from matcap.capture.run import read_exposures

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
    # The first one's are the report's, so that both agree.
    looked_at = [result.measurements.photograph, *map(photograph_quality, photos[1:])]
    record = _about(job, looked_at, result)
    with recorded(job.out / job.name, record):
        write_outputs(result, job.out / job.name, settings.outputs)
        record["seconds"] = round(time.perf_counter() - started, 3)
        record["peak_bytes"] = _peak_bytes()
        record["thumbnails"] = _thumbnails(result)
    del record["thumbnails"]
    return record


def measured(settings: CaptureSettings, card: Calibration | None) -> CaptureSettings:
    """Settings with the width that the card's chessboard measured, unless a width is given."""
    if settings.width_cm is not None or card is None or card.millimetres_per_unit is None:
        return settings
    return replace(settings, width_cm=2.0 * card.millimetres_per_unit / 10.0)


def _about(job: BatchJob, looked_at: Sequence[Inspection], result: CaptureResult) -> dict[str, Any]:
    """The record of a material, for the index."""
    from matcap.capture.report import warnings

    verdict = result.verdict
    warned = [*([] if verdict.rating.value == "good" else [f"Verdict {verdict.sentence()}"])]
    stated = " ".join(warned).lower()
    lines = list(warnings(result))
    if job.detail != job.settings.capture.most_detail:
        lines.append(f"Memory ran out; captured again at a detail of {job.detail} texels across.")
    for inspection in looked_at:
        of = f"{inspection.name}: " if len(looked_at) > 1 else ""
        poor = [f.line() for f in inspection.findings if not f.rating.fit]
        lines += [f"{of}{one}" for one in poor if one not in lines]
    # The verdict states what of the photograph is worst, and may give its remedy.
    warned += [s for s in lines if not all(p in stated for p in s.lower().rstrip(".").split(". "))]
    tilt = result.material.setup.tilt
    return {
        "name": job.name,
        "identity": job.identity,
        "photographs": [str(path) for path in job.photos],
        "detail": round(2.0 / result.material.texel_size),
        "most_detail": job.detail,
        "verdict": {"rating": verdict.rating.value, "severity": round(verdict.severity, 3)},
        "error": result.errors,
        "tilt_degrees": [round(angle * 57.29577951, 3) for angle in tilt],
        "clipped": round(result.photo.clipped_share, 5),
        "doubtful": not (verdict.fit and all(one.rating.fit for one in looked_at)),
        "warnings": list(dict.fromkeys(warned)),
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
    import torch  # noqa: F401

    keep_memory()
    compute_alone()
    cv2.setNumThreads(1)
