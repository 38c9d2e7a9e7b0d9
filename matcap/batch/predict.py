"""Predict a batch's time and disk space from the materials that it has made."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matcap.batch.entries import BatchEntry
from matcap.batch.record import FILE, read_record
from matcap.batch.whole import Prepared
from matcap.capture.settings import resolve
from matcap.files.values import spoken_duration


@dataclass(frozen=True)
class Prediction:
    """Number of samples to do, with predicted time, disk space and memory."""

    todo: int
    """Samples to be captured."""
    workers: int
    """Worker processes."""
    seconds_each: float | None
    """Wall time, seconds, of a sample on one worker; None before a material is made."""
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
    """Predict time and disk space of the samples to do, from materials in the output.

    Those count that were made with the same steps and detail.
    """
    settings, out = prepared.settings, prepared.out
    wanted = (resolve(settings.capture).steps, settings.capture.most_detail)
    records = (read_record(file.parent) for file in sorted(out.glob(f"*/{FILE}")))
    made = [one for one in records if one and (one.get("steps"), one.get("detail")) == wanted]
    return Prediction(
        len(prepared.todo),
        prepared.workers,
        sum(float(one["seconds"]) for one in made) / len(made) if made else None,
        max((sum(one["files"].values()) for one in made), default=settings.outputs.room),
        prepared.worker_bytes,
        shutil.disk_usage(next(p for p in (out, *out.parents) if p.exists())).free,
        f"measured on {len(made)} made before" if made else "no material is made yet",
    )
