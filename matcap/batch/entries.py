"""The state of each sample of a batch (to do, done, failed), read from the output files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from matcap.batch.identity import identity
from matcap.batch.input_folder import ShotSample
from matcap.batch.record import is_done, read_record
from matcap.batch.settings import BatchSettings
from matcap.batch.workspace import read_failure
from matcap.capture.replace import refuse_to_replace_longer_capture
from matcap.errors import MatcapError

EntryState = Literal["todo", "made", "kept", "failed", "left"]


@dataclass(frozen=True)
class Policy:
    """Which samples are captured again, and what counts as failure."""

    force: bool = False
    """Make materials again that are done."""
    retry_failed: bool = False
    """Try samples again that failed."""
    fail_fast: bool = False
    """End at the first failure."""
    strict: bool = False
    """Doubtful and failed verdicts count as failures in the exit code."""
    overwrite: bool = False
    """Replace captures of a longer preset."""


@dataclass
class BatchEntry:
    """A sample and its state, which the batch updates."""

    sample: ShotSample
    """Name and photographs of the sample."""
    identity: str
    """Hash of the material to be made (identity.py); "" if a photograph cannot be read."""
    state: EntryState
    """"todo"; "made" by this run; "kept", done by an earlier one; "failed"; or "left", not begun
    because the batch ended early."""
    reason: str = ""
    """Why it failed or was left."""
    record: dict[str, Any] = field(default_factory=dict)
    """Record of the material (record.py); empty if not captured yet."""


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
