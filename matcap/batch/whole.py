"""A batch in two steps: plan (inspect every sample), then run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from matcap.batch.cameras import with_profiles
from matcap.batch.entries import BatchEntry, make_plan
from matcap.batch.identity import prior_hash
from matcap.batch.memory import crew_size, largest_worker
from matcap.batch.overview import write_index
from matcap.batch.run import Batch, Policy, Show, exit_code
from matcap.batch.settings import BatchSettings
from matcap.batch.shoot import Grouping, ShotSample, find_samples
from matcap.batch.work import do_job, settle_threads
from matcap.batch.worker_pool import BatchWorkers, Machines, Processes
from matcap.batch.workspace import open_run
from matcap.errors import ExitCode, MatcapError
from matcap.files.memory import free_bytes
from matcap.files.staging import check_writable
from matcap.photo.calibrate import Calibration, card_sentence, read_card
from matcap.photo.camera import CameraProfile, write_camera_profile

_SETS_SAID = 12  # sets that are named before a batch starts


@dataclass(frozen=True)
class Prepared:
    """A batch that has been looked at."""

    out: Path
    """The output folder."""
    settings: BatchSettings
    """Of the batch."""
    entries: Sequence[BatchEntry]
    """How every sample stands."""
    worker_bytes: int
    """Memory that one worker takes at most."""
    workers: int
    """How many there will be."""
    card: Calibration | None = None
    """Calibration from the shoot's card, or None."""
    profiles: Mapping[Path, CameraProfile] = field(default_factory=dict)
    """Of the shoot's cameras, each with its file in the output."""

    @property
    def todo(self) -> list[BatchEntry]:
        """What is left to be made."""
        return [entry for entry in self.entries if entry.state == "todo"]


def prepare(
    shoot: Path, out: Path, settings: BatchSettings, policy: Policy, show: Show
) -> Prepared:
    """Find the samples and see what is done; writes nothing.

    Raises:
        MatcapError: no such folder, no photographs in it, no such prior, an unwritable output.
    """
    prior = prior_hash(settings.capture.prior)
    group = cast(Grouping, settings.group)
    cards = _cards(shoot, settings.card, out)
    samples = find_samples(shoot, group=group, gap=settings.gap, without=(out, *cards))
    for sentence in group_sentences(samples):
        show.note(sentence)
    card = read_card(cards[0], fov=settings.capture.fov) if cards else None
    show.note(card_sentence(card))
    samples, profiles = with_profiles(
        samples, shoot, out, settings.capture, show.note, again=policy.force
    )
    check_writable(out, settings.outputs.room)
    entries = make_plan(
        samples,
        out,
        settings,
        prior=prior,
        card=card.digest if card else "",
        force=policy.force,
        retry_failed=policy.retry_failed,
        overwrite=policy.overwrite,
    )
    todo = [entry for entry in entries if entry.state == "todo"]
    each = largest_worker(settings, [photo for e in todo for photo in e.sample.photos])
    workers = crew_size(settings.jobs, each, len(todo))
    if settings.jobs and workers < min(settings.jobs, len(todo)):
        show.note(
            f"Only {workers} of {settings.jobs} workers: each may take {each / 1e9:.1f} GB, "
            f"and {free_bytes() / 1e9:.1f} GB are free."
        )
    return Prepared(out, settings, entries, each, workers, card, profiles)


def group_sentences(samples: Sequence[ShotSample]) -> list[str]:
    """Which photographs become one material together, before anything starts."""
    sets = [sample for sample in samples if len(sample.photos) > 1]
    said = [
        f"{sample.name}: {len(sample.photos)} photographs of one piece "
        f"({', '.join(photo.name for photo in sample.photos)})."
        for sample in sets[:_SETS_SAID]
    ]
    if len(sets) > _SETS_SAID:
        said.append(f"And {len(sets) - _SETS_SAID} sets more; --dry-run names them all.")
    return [*said, "If they are not, use --group none."] if sets else []


def _cards(shoot: Path, wanted: str, out: Path) -> list[Path]:
    """The photograph of the card, first, and files of it that are no samples either."""
    if wanted not in ("auto", "none"):
        return [Path(wanted)]
    if wanted == "none" or not shoot.is_dir():
        return []
    cards = [
        file
        for sample in find_samples(shoot, without=(out,))
        if sample.photos[0].stem.casefold().startswith("card")
        for file in (*sample.photos, *sample.superseded)
    ]
    return cards


def work_off(
    prepared: Prepared, policy: Policy, show: Show, scheduler: str | None = None
) -> ExitCode:
    """Make everything that is to be made, and the index.

    Args:
        prepared: as prepare gives it; its entries change.
        policy: what to make of failures.
        show: who watches.
        scheduler: of a dask cluster that works; by default as many processes as fit.

    Raises:
        MatcapError: the output cannot be written at all, or no such scheduler.
        KeyboardInterrupt: Ctrl-C; what is done is done, the index is written.
    """
    out, entries = prepared.out, prepared.entries

    def page() -> None:
        try:
            write_index(out, entries)
        except MatcapError as error:
            show.note(str(error))  # the materials matter more than their page

    with open_run(out) as run:
        for file, profile in prepared.profiles.items():
            write_camera_profile(file, profile)
        show.expect(len(entries))
        for entry in entries:
            if entry.state != "todo":
                show.ended(entry)
        crew: BatchWorkers
        if scheduler is None:
            crew = Processes(prepared.workers, do_job, settle_threads)
        else:
            crew = Machines(scheduler, do_job, settle_threads)
        settings, card = prepared.settings, prepared.card
        Batch(entries, run, crew, settings, policy, show, page, card).go()
    return exit_code(entries, strict=policy.strict)
