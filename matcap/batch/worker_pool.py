"""A pool of worker processes that survives the death of a worker.

The standard library's pool breaks as a whole when a process is killed, and does not say which job
it had. Here every worker has its own pipe, and its death is an event. Workers end when the main
process ends, however it ends.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, Literal

from matcap.errors import MatcapError
from matcap.files.names import OnProgress, Progress, ignore_progress
from matcap.files.process import Cluster, RemoteResult, settle_child, starting_children

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
        pipe.send(("done", work(job, on_progress)))


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
        self._cluster = Cluster(scheduler, "dask worker --nthreads 1")
        self.size = self._cluster.threads
        self._work, self._prepare = work, prepare
        self._jobs: dict[RemoteResult, Any] = {}

    def busy(self) -> int:
        """Number of running jobs."""
        return len(self._jobs)

    def start(self, job: Any) -> None:  # noqa: ANN401
        """Start a job on an idle worker."""
        self._jobs[self._cluster.submit(_there, self._work, self._prepare, job)] = job

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
        self._cluster.close()


BatchWorkers = Processes | Machines


def _there(work: DoWork, prepare: Prepare, job: Any) -> Any:  # noqa: ANN401
    prepare()
    return work(job, ignore_progress)
