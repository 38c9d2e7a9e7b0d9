"""Scheduling of a batch: which worker gets which sample, and how failures are retried.

All state is in files: a batch that is killed and started again continues.
"""

from __future__ import annotations

import shutil
import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from matcap.batch.entries import BatchEntry, Policy
from matcap.batch.settings import BatchSettings
from matcap.batch.work import BatchJob, Failure
from matcap.batch.worker_pool import BatchWorkers, Event
from matcap.batch.workspace import Run
from matcap.errors import ExitCode
from matcap.files.progress import Progress
from matcap.photo.calibrate import Calibration
from matcap.photo.checks import Rating

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

        Raises:
            KeyboardInterrupt: re-raised after the workers are stopped and the index is written.
        """
        try:
            while self._waiting or self._alone or self._workers.busy():
                if self._stop:
                    self._waiting.clear()
                    self._alone.clear()
                self._fill()
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
