"""Predict a batch's time and disk space, from earlier captures or a short trial of the first."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from matcap.batch.entries import BatchEntry
from matcap.batch.record import FILE, read_record
from matcap.batch.settings import BatchSettings
from matcap.batch.whole import Prepared
from matcap.batch.work import settle_threads
from matcap.capture.progress import CaptureProgress
from matcap.capture.settings import resolve
from matcap.errors import MatcapError
from matcap.files.values import spoken_duration

_TRIAL_STEPS = 12  # of fine-tuning, in a trial of a decoder
_SETTLED = 4  # its first steps, which are slower and not timed
_TRIED = 3  # most samples tried, if the first are unusable


@dataclass(frozen=True)
class Prediction:
    """Number of samples to do, with predicted time, disk space and memory."""

    todo: int
    """Samples to be captured."""
    workers: int
    """Worker processes."""
    seconds_each: float | None
    """Wall time, seconds, of a sample on one worker; None if no photograph could be tried."""
    bytes_each: int
    """Disk space of a material."""
    worker_bytes: int
    """Upper bound of a worker's memory."""
    free_bytes: int
    """Free disk space."""
    measured: str
    """What the speed was measured on, in words."""

    @property
    def seconds(self) -> float | None:
        """Wall time of the whole batch, seconds, if nothing else uses the processor."""
        if self.seconds_each is None:
            return None
        return self.seconds_each * -(-self.todo // self.workers)

    def text(self) -> str:
        """The prediction as a sentence."""
        if not self.todo:
            return "Nothing to do: all materials are made."
        pace = "time unknown"
        if self.seconds is not None and self.seconds_each is not None:
            each = spoken_duration(self.seconds_each)
            pace = f"about {spoken_duration(self.seconds)} of wall time, {each} each"
        full = "" if self.bytes_each * self.todo < self.free_bytes else ", more than is free"
        return (
            f"{self.todo} to capture with {self.workers} workers: {pace} ({self.measured}); "
            f"about {self.bytes_each * self.todo / 1e9:.2g} GB of disk{full}; "
            f"at most {self.worker_bytes / 1e9:.1f} GB of memory a worker."
        )

    def document(self, entries: Sequence[BatchEntry]) -> dict[str, Any]:
        """The prediction as JSON."""
        rows = [
            {
                "name": entry.sample.name,
                "photographs": [str(photo) for photo in entry.sample.photos],
                "superseded": [str(photo) for photo in entry.sample.superseded],
                "status": {"todo": "to do", "kept": "done"}.get(entry.state, entry.state),
                "reason": entry.reason or None,
            }
            for entry in entries
        ]
        return {
            "materials": rows,
            "todo": self.todo,
            "workers": self.workers,
            "seconds": self.seconds,
            "seconds_each": self.seconds_each,
            "disk_bytes": self.bytes_each * self.todo,
            "worker_bytes": self.worker_bytes,
            "measured": self.measured,
        }


def predict(prepared: Prepared) -> Prediction:
    """Predict time and disk space of the samples to do.

    From materials in the output that were made with the same steps and detail; else from a trial
    capture, which is discarded; of a decoder, with a few steps.
    """
    todo, settings, out = prepared.todo, prepared.settings, prepared.out
    seconds, size, how = None, settings.outputs.room, "nothing measured"
    if todo:
        before = _from_before(prepared)
        if before is not None:
            seconds, size, how = before
        for entry in todo[:_TRIED]:
            if seconds is not None:
                break
            try:
                seconds, size = _trial(entry.sample.photos, settings)
                how = f"measured on {entry.sample.photos[0].name} alone, longer under load"
            except MatcapError:
                continue
    return Prediction(
        len(todo),
        prepared.workers,
        seconds,
        size,
        prepared.worker_bytes,
        shutil.disk_usage(next(p for p in (out, *out.parents) if p.exists())).free,
        how,
    )


def _from_before(prepared: Prepared) -> tuple[float, int, str] | None:
    earlier = []
    capture = prepared.settings.capture
    steps = resolve(capture).steps
    for file in sorted(prepared.out.glob(f"*/{FILE}")):
        record = read_record(file.parent)
        made = record and (record.get("steps"), record.get("detail"))
        if record and made == (steps, capture.most_detail):
            earlier.append((float(record["seconds"]), sum(record["files"].values())))
    if not earlier:
        return None
    seconds = sum(s for s, _ in earlier) / len(earlier)
    return seconds, max(size for _, size in earlier), f"measured on {len(earlier)} made before"


def _trial(photos: Sequence[Path], settings: BatchSettings) -> tuple[float, int]:
    """Seconds and bytes of one capture; a decoder's extrapolated from one with fewer steps."""
    from matcap.capture.outputs import write_outputs
    from matcap.capture.pipeline import capture_file

    settle_threads()
    began = time.perf_counter()
    wanted = settings.capture
    work = resolve(wanted).steps
    steps = min(work, _TRIAL_STEPS)
    ticks: list[float] = []  # time after each optimisation step, in seconds

    def on_progress(now: CaptureProgress) -> None:
        if now.stage == "fine-tuning":
            ticks.append(now.seconds)

    short = replace(wanted, steps=steps, time_limit=None, target=None) if work else wanted
    result = capture_file(photos[0], short, on_progress, others=photos[1:])
    with tempfile.TemporaryDirectory(prefix="matcap-") as folder:
        write_outputs(result, Path(folder) / "trial", settings.outputs)
        size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    spent = time.perf_counter() - began
    steady = ticks[_SETTLED:-1]  # the last one is the stage's end
    pace = (steady[-1] - steady[0]) / (len(steady) - 1) if len(steady) > 1 else 0.0
    seconds = spent + pace * (work - steps)
    limit = wanted.time_limit
    return seconds if limit is None else min(seconds, max(limit, spent)), size
