"""The state of each sample of a batch (to do, done, failed), read from the output files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from matcap.batch.identity import identity
from matcap.batch.record import is_done, read_record
from matcap.batch.settings import BatchSettings
from matcap.batch.shoot import ShotSample
from matcap.batch.workspace import read_failure
from matcap.capture.replace import refuse_to_replace_longer_capture
from matcap.errors import MatcapError

EntryState = Literal["todo", "made", "kept", "failed", "left"]


@dataclass
class BatchEntry:
    """A sample and how it stands; the batch goes along and changes it."""

    sample: ShotSample
    """What it is."""
    identity: str
    """Of the material wanted, or "" where a photograph cannot be read."""
    state: EntryState
    """Either "todo"; "made" by this run; "kept", done before; "failed"; "left" undone because the
    batch ended early."""
    reason: str = ""
    """Of a failure, or why it was left."""
    record: dict[str, Any] = field(default_factory=dict)
    """Of the material, where there is one."""


def make_plan(
    samples: Sequence[ShotSample],
    out: Path,
    settings: BatchSettings,
    *,
    prior: str,
    card: str = "",
    force: bool = False,
    retry_failed: bool = False,
    overwrite: bool = False,
    on_progress: Callable[[int], None] = lambda count: None,
) -> list[BatchEntry]:
    """How every sample stands.

    Args:
        samples: of the shoot.
        out: where their materials are or will be.
        settings: of the batch.
        prior: hash of the prior.
        card: hash of the calibration, or "".
        force: make even what is done.
        retry_failed: try even what is known to fail.
        overwrite: make even what would replace a longer capture.
        on_progress: called with the number of samples looked at.
    """
    entries = []
    for index, sample in enumerate(samples):
        on_progress(index)
        entry = _entry(sample, settings, prior, card)
        if entry.state == "todo":
            look_again(
                entry, out, settings, force=force, retry_failed=retry_failed, overwrite=overwrite
            )
        entries.append(entry)
    return entries


def look_again(
    entry: BatchEntry,
    out: Path,
    settings: BatchSettings,
    *,
    force: bool = False,
    retry_failed: bool = False,
    overwrite: bool = False,
) -> None:
    """See whether a material is done, known to fail, or would replace a longer capture, now."""
    folder = out / entry.sample.name
    if not force and is_done(folder, entry.identity):
        entry.state, entry.record = "kept", read_record(folder) or {}
        return
    known = None if force or retry_failed else read_failure(out, entry.sample.name)
    if known is not None and known.get("identity") == entry.identity:
        entry.state, entry.reason = "failed", str(known.get("reason", "it failed before"))
        return
    try:
        if not overwrite:
            refuse_to_replace_longer_capture(folder, settings.capture, len(entry.sample.photos))
    except MatcapError as error:
        entry.state, entry.reason, entry.record = "failed", str(error), read_record(folder) or {}


def _entry(sample: ShotSample, settings: BatchSettings, prior: str, card: str) -> BatchEntry:
    try:
        wanted = identity(sample.photos, settings, prior=prior, card=card, profile=sample.profile)
        return BatchEntry(sample, wanted, "todo")
    except MatcapError as error:
        return BatchEntry(sample, "", "failed", str(error))
