"""A batch: list the samples and their states, capture those to do, retry failures; its forecast."""

from __future__ import annotations

import multiprocessing
import shutil
import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Literal, Protocol, cast

from matcap.batch import work
from matcap.batch.overview import write_index
from matcap.batch.samples import (
    BatchSettings,
    Grouping,
    Policy,
    ShotSample,
    find_samples,
    prior_hash,
)
from matcap.capture.settings import resolve
from matcap.errors import ExitCode, MatcapError
from matcap.files.names import OnProgress, Progress, ignore_progress
from matcap.files.output import check_writable
from matcap.files.process import (
    RemoteResult,
    dask_client,
    dask_threads,
    free_bytes,
    postponed,
    returning_memory,
    settle_child,
    starting_children,
)
from matcap.files.settings import spoken_duration
from matcap.photo.calibrate import Calibration, card_sentence, read_card
from matcap.photo.checks import Rating

# A pool of worker processes that survives the death of a worker.
#
# The standard library's pool breaks as a whole when a process is killed, and does not say which job
# it had. Here every worker has its own pipe, and its death is an event. Workers end when the main
# process ends, however it ends.

DoWork = Callable[[Any, OnProgress], Any]
Prepare = Callable[[], None]
_POLL_EVERY = 0.1  # seconds


@dataclass(frozen=True)
class Event:
    """An event of a job."""

    job: Any
    """The job given to start()."""
    kind: Literal["progress", "done", "died"]
    value: Any
    """A Progress; the work's result; or the process's exit code, negative for a signal."""


class Processes:
    """A pool of processes on this machine, started on demand.

    Args:
        size: most processes.
        work: a module-level function, called with a job and a progress callback.
        prepare: called once in every new process.
    """

    def __init__(self, size: int, work: DoWork, prepare: Prepare) -> None:
        self.size = size
        self._work, self._prepare = work, prepare
        self._idle: list[_Worker] = []
        self._working: dict[Connection, tuple[_Worker, Any]] = {}

    def busy(self) -> int:
        """Number of running jobs."""
        return len(self._working)

    def start(self, job: Any) -> None:  # noqa: ANN401
        """Start a job on an idle worker."""
        while self._idle:
            worker = self._idle.pop()
            if worker.give(job):
                break
        else:
            worker = _Worker(self._work, self._prepare)
            worker.give(job)
        self._working[worker.pipe] = (worker, job)

    def wait(self, seconds: float) -> list[Event]:
        """Events since the last call; waits up to `seconds` for the first."""
        events = []
        for pipe in connection.wait(list(self._working), seconds):
            assert isinstance(pipe, Connection)
            worker, job = self._working[pipe]
            try:
                kind, value = pipe.recv()
            except (EOFError, OSError):
                del self._working[pipe]
                events.append(Event(job, "died", worker.end()))
                continue
            events.append(Event(job, kind, value))
            if kind == "done":
                del self._working[pipe]
                self._idle.append(worker)
        return events

    def close(self) -> None:
        """Kill all workers."""
        for worker in [*self._idle, *(worker for worker, _ in self._working.values())]:
            worker.kill()
        self._idle, self._working = [], {}


class _Worker:
    def __init__(self, work: DoWork, prepare: Prepare) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process: SpawnProcess = context.Process(
            target=_serve, args=(theirs, work, prepare), daemon=True
        )
        with starting_children():
            self._process.start()
        theirs.close()

    def give(self, job: Any) -> bool:  # noqa: ANN401
        """Send a job; returns False if the worker died while idle."""
        try:
            self.pipe.send(job)
        except OSError:
            self.kill()
            return False
        return True

    def end(self) -> int:
        """Exit code of a process whose pipe is closed; kills it if it still runs after 5 s."""
        self._process.join(5.0)
        code = self._process.exitcode
        self.kill()
        return -signal.SIGKILL if code is None else code

    def kill(self) -> None:
        self._process.kill()
        self._process.join()
        self.pipe.close()


def _serve(pipe: Connection, work: DoWork, prepare: Prepare) -> None:
    settle_child()
    prepare()

    def on_progress(now: Progress) -> None:
        pipe.send(("progress", now))

    while True:
        try:
            job = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(("done", work(job, returning_memory(on_progress))))


class Machines:
    """The workers of a dask cluster as a pool; as many jobs at once as they have threads.

    Every machine must see input and output folder under the same paths. Jobs report no progress,
    only their end.

    Args:
        scheduler: address, such as tcp://host:8786.
        work: a module-level function, called with a job and a progress callback.
        prepare: called before every job.

    Raises:
        MatcapError: dask is not installed, the scheduler does not answer, or has no worker.
    """

    def __init__(self, scheduler: str, work: DoWork, prepare: Prepare) -> None:
        self._client = dask_client(scheduler, "dask worker --nthreads 1")
        self.size = dask_threads(self._client)
        self._work, self._prepare = work, prepare
        self._jobs: dict[RemoteResult, Any] = {}

    def busy(self) -> int:
        """Number of running jobs."""
        return len(self._jobs)

    def start(self, job: Any) -> None:  # noqa: ANN401
        """Start a job on an idle worker."""
        self._jobs[RemoteResult(self._client, _there, self._work, self._prepare, job)] = job

    def wait(self, seconds: float) -> list[Event]:
        """Events since the last call; waits up to `seconds` for the first."""
        limit = time.monotonic() + seconds
        while not any(one.done() for one in self._jobs) and time.monotonic() < limit:
            time.sleep(_POLL_EVERY)
        events = []
        for one in [one for one in self._jobs if one.done()]:
            job = self._jobs.pop(one)
            try:
                events.append(Event(job, "done", one.result()))
            except MatcapError:
                # Work returns its failures: an error here is a lost worker.
                events.append(Event(job, "died", 1))
        return events

    def close(self) -> None:
        """Kill all workers."""
        for one in self._jobs:
            one.cancel()
        self._jobs = {}
        self._client.close()


BatchWorkers = Processes | Machines


def _there(work: DoWork, prepare: Prepare, job: Any) -> Any:  # noqa: ANN401
    prepare()
    return work(job, ignore_progress)


# Scheduling of a batch: which worker gets which sample, and how failures are retried.
#
# All state is in files: a batch that is killed and started again continues.

_POLL = 1.0  # seconds that events are waited for
_PAGE_EVERY = 20.0  # least seconds between two updates of the index
_START = 5.0  # seconds of one core before the first sample: libraries of batch and worker
_LEAST_DETAIL = 128  # texels across: the least detail that is tried when memory runs out
_FORGET = ("memory", "disk", "crash")  # failures that are not recorded: they may pass
_AGAIN = "Free some space and run the same command again."


class Show(Protocol):
    """Displays the progress of a batch."""

    def expect(self, total: int) -> None:
        """Set the number of samples."""

    def started(self, entry: work.BatchEntry) -> None:
        """A sample's capture has started."""

    def progress(self, entry: work.BatchEntry, now: Progress) -> None:
        """A sample's stage and share of the work."""

    def ended(self, entry: work.BatchEntry) -> None:
        """A sample has reached its final state."""

    def note(self, sentence: str) -> None:
        """Show a message."""


@dataclass(frozen=True)
class Prepared:
    """A batch that is ready to run."""

    out: Path
    """The output folder."""
    settings: BatchSettings
    entries: Sequence[work.BatchEntry]
    """All samples with their states."""
    worker_bytes: int
    """Upper bound of a worker's memory."""
    workers: int
    """Number of worker processes."""
    card: Calibration | None = None
    """Calibration from a card's photograph, or None."""

    @property
    def todo(self) -> list[work.BatchEntry]:
        """The samples that are still to be captured."""
        return [entry for entry in self.entries if entry.state == "todo"]


class Batch:
    """One run over the samples of a batch.

    Args:
        prepared: by prepare(); the states of its entries are updated.
    """

    def __init__(
        self, prepared: Prepared, workers: BatchWorkers, policy: Policy, show: Show
    ) -> None:
        self._prepared, self._out, self._workers = prepared, prepared.out, workers
        self._policy, self._show = policy, show
        self._settings = settings = prepared.settings
        self._entries = {entry.sample.name: entry for entry in prepared.entries}
        rest = (settings, self._out, settings.capture.most_detail, False, prepared.card)
        self._waiting = deque(
            work.BatchJob(entry.sample.name, entry.sample.photos, entry.identity, *rest)
            for entry in prepared.todo
        )
        self._alone: deque[work.BatchJob] = deque()
        self._running: dict[str, work.BatchJob] = {}
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
        except KeyboardInterrupt:
            self._stop = self._stop or "interrupted"
            raise
        finally:
            self._workers.close()
            for entry in self._prepared.todo:
                entry.state, entry.reason = "left", self._stop or "the batch ended early"
            self._page()

    def _page(self) -> None:
        """Write the index; a failure must not end the batch."""
        try:
            write_index(self._out, self._prepared.entries)
        except MatcapError as error:
            self._show.note(str(error))
        self._paged = time.monotonic()

    def _fill(self) -> None:
        """Start jobs on all idle workers."""
        alone = any(job.alone for job in self._running.values())
        while self._waiting and not alone and self._workers.busy() < self._workers.size:
            self._begin(self._waiting.popleft())
        if self._alone and not self._waiting and not self._workers.busy():
            self._begin(self._alone.popleft())

    def _begin(self, job: work.BatchJob) -> None:
        room = self._settings.outputs.room
        if shutil.disk_usage(self._out).free < room:
            self._stop = f"the disk has less than {room / 1e6:.0f} MB left"
            self._show.note(f"No further sample is started: {self._stop}. {_AGAIN}")
            return
        self._show.started(self._entries[job.name])
        self._running[job.name] = job
        self._workers.start(job)

    def _happened(self, event: Event) -> None:
        job, entry = self._running[event.job.name], self._entries[event.job.name]
        if event.kind == "progress":
            self._show.progress(entry, event.value)
            return
        del self._running[job.name]
        if event.kind == "died":
            self._failed(job, _of_death(job.photos[0], event.value), again=True)
        elif isinstance(event.value, work.Failure):
            self._failed(job, event.value)
        else:
            entry.state, entry.record = "made", event.value
            work.forget_failure(self._out, job.name)
            self._show.ended(entry)

    def _failed(self, job: work.BatchJob, failure: work.Failure, *, again: bool = False) -> None:
        following = self._following(job, failure, again)
        if following is not None:
            smaller = following.detail < job.detail
            how = f"at a detail of {following.detail}" if smaller else "by itself"
            self._show.note(f"{failure.sentence} Trying again {how}.")
            self._alone.append(following)
            return
        entry = self._entries[job.name]
        entry.state, entry.reason = "failed", failure.sentence
        if failure.kind not in _FORGET:
            about = {"identity": entry.identity, "reason": failure.sentence}
            work.write_failure(self._out, job.name, about)
        self._show.ended(entry)
        if failure.kind == "disk":
            self._stop = self._stop or "the disk is full"
            self._show.note(f"No further sample is started: the disk is full. {_AGAIN}")
        if self._policy.fail_fast:
            self._stop = self._stop or "a photograph failed before, and --fail-fast was given"
            self._workers.close()
            self._running.clear()

    def _following(
        self, job: work.BatchJob, failure: work.Failure, again: bool
    ) -> work.BatchJob | None:
        """The next attempt: alone, then at half the detail; None gives up."""
        others = failure.kind == "memory" and self._workers.size > 1
        if failure.kind in ("memory", "crash") and not job.alone and (again or others):
            return replace(job, alone=True)
        half = job.detail // 2
        first = job.detail == self._settings.capture.most_detail
        if failure.kind == "memory" and half >= _LEAST_DETAIL and first:
            return replace(job, alone=True, detail=half)
        return None


def _of_death(photo: Path, code: int) -> work.Failure:
    """Why a worker has died: SIGKILL is taken for the system's out-of-memory killer."""
    if code == -signal.SIGKILL:
        message = f"{photo}: the system killed the worker, probably because memory ran out"
        return work.Failure("memory", f"{message}; lower --detail, --size or -j.")
    how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
    message = f"{photo}: the worker process crashed ({how})"
    return work.Failure("crash", f"{message}; report it, with the photograph.")


def exit_code(entries: Sequence[work.BatchEntry], *, strict: bool = False) -> ExitCode:
    """Exit code of a batch; with `strict` only materials with a good verdict count as made."""
    verdicts = [one.record.get("verdict") for one in entries if one.state in ("made", "kept")]
    unfit = [one for one in verdicts if one and not Rating(one["rating"]).fit]
    return ExitCode.of(len(verdicts) - (len(unfit) if strict else 0), len(entries))


# A batch in two steps: prepare (list the samples and their states), then capture them.

_SETS_SAID = 12  # most groups of photographs that are listed before a batch starts


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
    entries = work.make_plan(samples, out, settings, policy, prior=prior, card=digest)
    todo = [entry for entry in entries if entry.state == "todo"]
    each = work.largest_worker(settings, [photo for e in todo for photo in e.sample.photos])
    workers = work.pool_size(settings.jobs, each, len(todo))
    if settings.jobs and workers < min(settings.jobs, len(todo)):
        show.note(
            f"Using {workers} workers instead of {settings.jobs}: each may need "
            f"{each / 1e9:.1f} GB of memory, and {free_bytes() / 1e9:.1f} GB are free."
        )
    return Prepared(out, settings, entries, each, workers, card)


def group_sentences(samples: Sequence[ShotSample]) -> list[str]:
    """Sentences that list the groups of photographs that become one material each."""
    sets = [sample for sample in samples if len(sample.photos) > 1]
    lines = [
        f"{sample.name}: {len(sample.photos)} photographs of one sample "
        f"({', '.join(photo.name for photo in sample.photos)})."
        for sample in sets[:_SETS_SAID]
    ]
    if len(sets) > _SETS_SAID:
        lines.append(f"And {len(sets) - _SETS_SAID} more groups; --dry-run lists all.")
    return [*lines, "If they show different samples, use --group none."] if sets else []


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
    entries = prepared.entries
    with work.open_run(prepared.out):
        show.expect(len(entries))
        for entry in entries:
            if entry.state != "todo":
                show.ended(entry)
        workers: BatchWorkers
        if scheduler is None:
            workers = Processes(prepared.workers, work.do_job, work.settle_threads)
        else:
            workers = Machines(scheduler, work.do_job, work.settle_threads)
        Batch(prepared, workers, policy, show).go()
    return exit_code(entries, strict=policy.strict)


def predict(prepared: Prepared) -> dict[str, Any]:
    """Predict time, disk space and memory of the samples to do, as JSON.

    From materials in the output that were made with the same steps and most detail: wall time of a
    sample on one worker, and of the whole batch with its start if nothing else uses the processor;
    None before one is made. Entries whose files are no photographs by their first bytes fail.
    """
    from matcap.photo.load import file_kind

    for entry in prepared.todo:
        try:
            for photo in entry.sample.photos:
                file_kind(photo)
        except MatcapError as error:
            entry.state, entry.reason = "failed", str(error)
    settings, out, todo = prepared.settings, prepared.out, len(prepared.todo)
    workers = max(1, min(prepared.workers, todo))
    rounds = -(-todo // workers)
    wanted = (resolve(settings.capture).steps, settings.capture.most_detail)
    records = (work.read_record(file.parent) for file in sorted(out.glob(f"*/{work.FILE}")))
    # A photograph may have less than the most detail asked for.
    made = [one for one in records if one and (one.get("steps"), one.get("most_detail")) == wanted]
    each = sum(float(one["seconds"]) for one in made) / len(made) if made else None
    room = max((sum(one["files"].values()) for one in made), default=settings.outputs.room)
    rows = [
        {
            "name": entry.sample.name,
            "photographs": [str(photo) for photo in entry.sample.photos],
            "superseded": [str(photo) for photo in entry.sample.superseded],
            "status": {"todo": "to do", "kept": "done"}.get(entry.state, entry.state),
            "reason": entry.reason or None,
        }
        for entry in prepared.entries
    ]
    return {
        "materials": rows,
        "todo": todo,
        "workers": workers,
        "seconds": None if each is None else _START * (todo > 0) + each * rounds,
        "seconds_each": each,
        "disk_bytes": room * todo,
        "free_bytes": shutil.disk_usage(next(p for p in (out, *out.parents) if p.exists())).free,
        "worker_bytes": prepared.worker_bytes,
        "measured": f"measured on {len(made)} made before" if made else "no material is made yet",
    }


def prediction_text(known: dict[str, Any]) -> str:
    """What predict() returns as a sentence."""
    if not known["todo"]:
        failed = sum(row["status"] == "failed" for row in known["materials"])
        made = len(known["materials"]) - failed
        counted = [f"{made} made before"] * (made > 0) + [f"{failed} cannot be used"]
        return f"Nothing to do: {', '.join(counted) if failed else 'all is made'}."
    pace = "time unknown"
    if known["seconds"] is not None:
        whole, each = (spoken_duration(known[key]) for key in ("seconds", "seconds_each"))
        pace = f"about {whole} of wall time, {each} each"
    full = "" if known["disk_bytes"] < known["free_bytes"] else ", more than is free"
    return (
        f"{known['todo']} to capture with {known['workers']} workers: {pace} "
        f"({known['measured']}); about {known['disk_bytes'] / 1e9:.2g} GB of disk{full}; "
        f"at most {known['worker_bytes'] / 1e9:.1f} GB of memory a worker."
    )
