"""A batch: list the samples and their states, capture those to do, retry failures; its forecast."""

from __future__ import annotations

import shutil
import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, cast

from matcap.batch.overview import write_index
from matcap.batch.samples import BatchSettings, Grouping, ShotSample, find_samples, prior_hash
from matcap.batch.work import (
    FILE,
    BatchEntry,
    BatchJob,
    Failure,
    Policy,
    Run,
    do_job,
    largest_worker,
    make_plan,
    open_run,
    pool_size,
    read_record,
    settle_threads,
)
from matcap.batch.worker_pool import BatchWorkers, Event, Machines, Processes
from matcap.capture.settings import resolve
from matcap.errors import ExitCode, MatcapError
from matcap.files.names import Progress
from matcap.files.output import check_writable
from matcap.files.process import free_bytes, postponed
from matcap.files.settings import spoken_duration
from matcap.photo.calibrate import Calibration, card_sentence, read_card
from matcap.photo.checks import Rating

# Scheduling of a batch: which worker gets which sample, and how failures are retried.
#
# All state is in files: a batch that is killed and started again continues.

_POLL = 1.0  # seconds that events are waited for
_PAGE_EVERY = 20.0  # least seconds between two updates of the index
_LEAST_DETAIL = 128  # texels across: the least detail that is tried when memory runs out
_FORGET = ("memory", "disk", "crash")  # failures that are not recorded: they may pass
_AGAIN = "Free some space and run the same command again."


class Show(Protocol):
    """Displays the progress of a batch."""

    def expect(self, total: int) -> None:
        """Set the number of samples."""

    def started(self, entry: BatchEntry) -> None:
        """A sample's capture has started."""

    def progress(self, entry: BatchEntry, now: Progress) -> None:
        """A sample's stage and share of the work."""

    def ended(self, entry: BatchEntry) -> None:
        """A sample has reached its final state."""

    def note(self, sentence: str) -> None:
        """Show a message."""


@dataclass
class _Task:
    entry: BatchEntry
    job: BatchJob


class Batch:
    """One run over the samples of a batch.

    Args:
        entries: the samples; their states are updated.
        page: writes the index; called during the run and at its end.
        card: calibration from a card's photograph, or None.
    """

    def __init__(
        self,
        entries: Sequence[BatchEntry],
        run: Run,
        workers: BatchWorkers,
        settings: BatchSettings,
        policy: Policy,
        show: Show,
        page: Callable[[], None],
        card: Calibration | None = None,
    ) -> None:
        self._entries, self._run, self._workers = entries, run, workers
        self._settings, self._policy, self._show, self._page = settings, policy, show, page
        self._waiting: deque[_Task] = deque()
        for entry in (entry for entry in entries if entry.state == "todo"):
            sample, detail = entry.sample, settings.capture.most_detail
            of_sample = (sample.name, sample.photos, entry.identity)
            job = BatchJob(*of_sample, settings, run, detail, card=card)
            self._waiting.append(_Task(entry, job))
        self._alone: deque[_Task] = deque()
        self._tasks: dict[str, _Task] = {}
        self._stop = ""
        self._paged = time.monotonic()

    def go(self) -> None:
        """Process all samples until each is made, kept, failed or left.

        The first Ctrl-C lets running captures finish and starts no other; the second ends them.

        Raises:
            KeyboardInterrupt: after either, once the workers are stopped and the index is written.
        """
        with postponed() as signals:
            self._work_off(signals)
        if signals():
            raise KeyboardInterrupt

    def _work_off(self, signals: Callable[[], int]) -> None:
        try:
            while self._waiting or self._alone or self._workers.busy():
                if self._stop:
                    self._waiting.clear()
                    self._alone.clear()
                self._fill()
                if signals() > 1:
                    raise KeyboardInterrupt
                if signals() and not self._stop:
                    self._stop, running = "interrupted", self._workers.busy()
                    self._show.note(
                        f"Interrupted: {running} running will finish. Ctrl-C again ends at once."
                    )
                for event in self._workers.wait(_POLL) if self._workers.busy() else ():
                    self._happened(event)
                if time.monotonic() - self._paged > _PAGE_EVERY:
                    self._page()
                    self._paged = time.monotonic()
        except KeyboardInterrupt:
            self._stop = self._stop or "interrupted"
            raise
        finally:
            self._workers.close()
            for entry in self._entries:
                if entry.state == "todo":
                    entry.state, entry.reason = "left", self._stop or "the batch ended early"
            self._page()

    def _fill(self) -> None:
        """Start jobs on all idle workers."""
        alone = any(task.job.alone for task in self._tasks.values())
        while self._waiting and not alone and self._workers.busy() < self._workers.size:
            self._begin(self._waiting.popleft())
        if self._alone and not self._waiting and not self._workers.busy():
            self._begin(self._alone.popleft())

    def _begin(self, task: _Task) -> None:
        room = self._settings.outputs.room
        if shutil.disk_usage(self._run.out).free < room:
            self._stop = f"the disk has less than {room / 1e6:.0f} MB left"
            self._show.note(f"No further sample is started: {self._stop}. {_AGAIN}")
            return
        self._show.started(task.entry)
        self._tasks[task.job.name] = task
        self._workers.start(task.job)

    def _happened(self, event: Event) -> None:
        task = self._tasks[event.job.name]
        if event.kind == "progress":
            self._show.progress(task.entry, event.value)
            return
        del self._tasks[event.job.name]
        if event.kind == "died":
            self._died(task, event.value)
        elif isinstance(event.value, Failure):
            self._failed(task, event.value)
        else:
            task.entry.state, task.entry.record = "made", event.value
            self._run.forget_failure(task.job.name)
            self._show.ended(task.entry)

    def _died(self, task: _Task, code: int) -> None:
        """Handle a worker's death: SIGKILL is taken for the system's out-of-memory killer."""
        photo = task.entry.sample.photos[0]
        if code == -signal.SIGKILL:
            said = f"{photo}: the system killed the worker, probably because memory ran out"
            failure = Failure("memory", f"{said}; lower --detail, --size or -j.")
        else:
            how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
            said = f"{photo}: the worker process crashed ({how})"
            failure = Failure("crash", f"{said}; report it, with the photograph.")
        self._failed(task, failure, again=True)

    def _failed(self, task: _Task, failure: Failure, *, again: bool = False) -> None:
        following = self._following(task, failure, again)
        if following is not None:
            self._show.note(f"{failure.sentence} Trying again{following[1]}.")
            self._alone.append(following[0])
            return
        task.entry.state, task.entry.reason = "failed", failure.sentence
        if failure.kind not in _FORGET:
            about = {"identity": task.entry.identity, "reason": failure.sentence}
            self._run.write_failure(task.job.name, about)
        self._show.ended(task.entry)
        if failure.kind == "disk":
            self._stop = self._stop or "the disk is full"
            self._show.note(f"No further sample is started: the disk is full. {_AGAIN}")
        if self._policy.fail_fast:
            self._stop = self._stop or "a photograph failed before, and --fail-fast was given"
            self._workers.close()
            self._tasks.clear()

    def _following(self, task: _Task, failure: Failure, again: bool) -> tuple[_Task, str] | None:
        """The next attempt and its description: alone, then at half the detail; None gives up."""
        job = task.job
        others = failure.kind == "memory" and self._workers.size > 1
        if failure.kind in ("memory", "crash") and not job.alone and (again or others):
            return _Task(task.entry, replace(job, alone=True)), " by itself"
        if failure.kind != "memory":
            return None
        half = job.detail // 2
        if half < _LEAST_DETAIL or job.detail < self._settings.capture.most_detail:
            return None
        smaller = replace(job, alone=True, detail=half)
        return _Task(task.entry, smaller), f" at a detail of {half}"


def exit_code(entries: Sequence[BatchEntry], *, strict: bool = False) -> ExitCode:
    """Exit code of a batch; with `strict` only materials with a good verdict count as made."""
    good = sum(
        entry.state in ("made", "kept") and not (strict and _unfit(entry)) for entry in entries
    )
    return ExitCode.of(good, len(entries))


def _unfit(entry: BatchEntry) -> bool:
    """Whether the verdict is doubtful or failed."""
    verdict = entry.record.get("verdict")
    return verdict is not None and not Rating(verdict["rating"]).fit


# A batch in two steps: prepare (list the samples and their states), then capture them.

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


# Predict a batch's time and disk space from the materials that it has made.


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
