"""A batch in two steps: prepare (list the samples and their states), then capture them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from matcap.batch.entries import BatchEntry, Policy, make_plan
from matcap.batch.identity import prior_hash
from matcap.batch.input_folder import Grouping, ShotSample, find_samples
from matcap.batch.memory import largest_worker, pool_size
from matcap.batch.overview import write_index
from matcap.batch.run import Batch, Show, exit_code
from matcap.batch.settings import BatchSettings
from matcap.batch.work import do_job, settle_threads
from matcap.batch.worker_pool import BatchWorkers, Machines, Processes
from matcap.batch.workspace import open_run
from matcap.capture.settings import resolve
from matcap.errors import ExitCode, MatcapError
from matcap.files.memory import free_bytes
from matcap.files.output import check_writable
from matcap.photo.calibrate import Calibration, card_sentence, read_card

_SETS_SAID = 12  # most groups of photographs that are listed before a batch starts


@dataclass(frozen=True)
class Prepared:
    """A batch that is ready to run."""

    out: Path
    """The output folder."""
    settings: BatchSettings
    """Settings of the batch."""
    entries: Sequence[BatchEntry]
    """All samples with their states."""
    worker_bytes: int
    """Upper bound of a worker's memory."""
    workers: int
    """Number of worker processes."""
    card: Calibration | None = None
    """Calibration from a card's photograph, or None."""

    @property
    def todo(self) -> list[BatchEntry]:
        """The samples that are still to be captured."""
        return [entry for entry in self.entries if entry.state == "todo"]


def prepare(
    source: Path, out: Path, settings: BatchSettings, policy: Policy, show: Show
) -> Prepared:
    """List the samples of the folder `source` and determine their states; writes nothing.

    Raises:
        UsageError: settings contradict each other.
        MatcapError: no such folder, no photographs in it, no such prior, an unwritable output.
    """
    resolve(settings.capture)  # raises where settings contradict each other
    prior = prior_hash(settings.capture.prior)
    group = cast(Grouping, settings.group)
    cards = _cards(source, settings.card, out)
    samples = find_samples(source, group=group, gap=settings.gap, without=(out, *cards))
    for sentence in group_sentences(samples):
        show.note(sentence)
    card = read_card(cards[0], fov=settings.capture.fov) if cards else None
    show.note(card_sentence(card))
    check_writable(out, settings.outputs.room)
    digest = card.digest if card else ""
    entries = make_plan(samples, out, settings, policy, prior=prior, card=digest)
    todo = [entry for entry in entries if entry.state == "todo"]
    each = largest_worker(settings, [photo for e in todo for photo in e.sample.photos])
    workers = pool_size(settings.jobs, each, len(todo))
    if settings.jobs and workers < min(settings.jobs, len(todo)):
        show.note(
            f"Using {workers} workers instead of {settings.jobs}: each may need "
            f"{each / 1e9:.1f} GB of memory, and {free_bytes() / 1e9:.1f} GB are free."
        )
    return Prepared(out, settings, entries, each, workers, card)


def group_sentences(samples: Sequence[ShotSample]) -> list[str]:
    """Sentences that list the groups of photographs that become one material each."""
    sets = [sample for sample in samples if len(sample.photos) > 1]
    said = [
        f"{sample.name}: {len(sample.photos)} photographs of one sample "
        f"({', '.join(photo.name for photo in sample.photos)})."
        for sample in sets[:_SETS_SAID]
    ]
    if len(sets) > _SETS_SAID:
        said.append(f"And {len(sets) - _SETS_SAID} more groups; --dry-run lists all.")
    return [*said, "If they show different samples, use --group none."] if sets else []


def _cards(source: Path, wanted: str, out: Path) -> list[Path]:
    """Photographs of a calibration card, the one to use first; none of them is a sample."""
    if wanted not in ("auto", "none"):
        return [Path(wanted)]
    if wanted == "none" or not source.is_dir():
        return []
    return [
        file
        for sample in find_samples(source, without=(out,))
        if sample.photos[0].stem.casefold().startswith("card")
        for file in (*sample.photos, *sample.superseded)
    ]


def work_off(
    prepared: Prepared, policy: Policy, show: Show, scheduler: str | None = None
) -> ExitCode:
    """Capture all samples to do, and write the index.

    Args:
        prepared: by prepare(); its entries are updated.
        scheduler: address of a dask cluster's; by default processes of this machine.

    Raises:
        MatcapError: the output cannot be written, or the scheduler does not answer.
        KeyboardInterrupt: Ctrl-C; finished materials stay, the index is written.
    """
    out, entries = prepared.out, prepared.entries

    def page() -> None:
        try:
            write_index(out, entries)
        except MatcapError as error:
            show.note(str(error))  # a failed index must not end the batch

    with open_run(out) as run:
        show.expect(len(entries))
        for entry in entries:
            if entry.state != "todo":
                show.ended(entry)
        workers: BatchWorkers
        if scheduler is None:
            workers = Processes(prepared.workers, do_job, settle_threads)
        else:
            workers = Machines(scheduler, do_job, settle_threads)
        settings, card = prepared.settings, prepared.card
        Batch(entries, run, workers, settings, policy, show, page, card).go()
    return exit_code(entries, strict=policy.strict)
