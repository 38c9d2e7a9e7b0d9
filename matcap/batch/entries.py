"""What is to be done, what is done already, and what cannot be done: read from the files."""

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
from matcap.errors import MatcapError

State = Literal["todo", "made", "kept", "failed", "left"]


@dataclass
class BatchEntry:
    """A sample and how it stands; the batch goes along and changes it.

    Attributes:
        sample: what it is.
        identity: of the material wanted, or "" where a photograph cannot be read.
        state: "todo"; "made" by this run; "kept", done before; "failed"; "left" undone because
            the batch ended early.
        reason: of a failure, or why it was left.
        record: of the material, where there is one.
    """

    sample: ShotSample
    identity: str
    state: State
    reason: str = ""
    record: dict[str, Any] = field(default_factory=dict)


def make_plan(
    samples: Sequence[ShotSample],
    out: Path,
    settings: BatchSettings,
    *,
    prior: str,
    card: str = "",
    force: bool = False,
    retry_failed: bool = False,
    tell: Callable[[int], None] = lambda count: None,
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
        tell: called with how many have been looked at.
    """
    entries = []
    for index, sample in enumerate(samples):
        tell(index)
        entries.append(_entry(sample, out, settings, prior, card, force, retry_failed))
    return entries


def look_again(
    entry: BatchEntry, out: Path, *, force: bool = False, retry_failed: bool = False
) -> None:
    """See whether a material is done or known to fail, now."""
    folder = out / entry.sample.name
    if not force and is_done(folder, entry.identity):
        entry.state, entry.record = "kept", read_record(folder) or {}
        return
    known = None if force or retry_failed else read_failure(out, entry.sample.name)
    if known is not None and known.get("identity") == entry.identity:
        entry.state, entry.reason = "failed", str(known.get("reason", "it failed before"))


def _entry(
    sample: ShotSample,
    out: Path,
    settings: BatchSettings,
    prior: str,
    card: str,
    force: bool,
    retry_failed: bool,
) -> BatchEntry:
    try:
        digits = identity(sample.photos, settings, prior=prior, card=card)
    except MatcapError as error:
        return BatchEntry(sample, "", "failed", str(error))
    entry = BatchEntry(sample, digits, "todo")
    look_again(entry, out, force=force, retry_failed=retry_failed)
    return entry
