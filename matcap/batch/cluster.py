"""Whole samples on other machines: a crew of dask.distributed workers (extra `cluster`).

Every machine must see the shoot and the output under the same names. Progress inside a sample is
not told, only its end.
"""

from __future__ import annotations

import time
from importlib import import_module
from typing import Any

from matcap.batch.crew import Event, Prepare, Work
from matcap.errors import MatcapError

_PATIENCE = 10  # seconds for the scheduler to answer
_WORKERS_WITHIN = 60  # seconds for a first worker to come
_LOOK_EVERY = 0.1  # seconds; samples take minutes


class Cluster:
    """A crew of a scheduler's workers; as many jobs at once as they have threads.

    Args:
        scheduler: its address, such as tcp://host:8786.
        work: a module-level function, called with a job and a way to tell of its progress.
        prepare: called before every job.

    Raises:
        MatcapError: the extra is missing, nobody answers at the address, or there is no worker.
    """

    def __init__(self, scheduler: str, work: Work, prepare: Prepare) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as error:
            raise MatcapError(
                "clusters need dask.distributed", remedy='run: pip install "matcap[cluster]"'
            ) from error
        try:
            self._client: Any = distributed.Client(
                scheduler, timeout=_PATIENCE, set_as_default=False
            )
        except (OSError, TimeoutError, ValueError) as error:
            raise MatcapError(
                "no dask scheduler answers there",
                where=scheduler,
                remedy="start one with `dask scheduler`, and workers with `dask worker`",
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=_WORKERS_WITHIN)
        except TimeoutError as error:
            self._client.close()
            raise MatcapError(
                "the dask scheduler has no workers",
                where=scheduler,
                remedy="start some with `dask worker --nthreads 1`",
            ) from error
        self.size = sum(self._client.nthreads().values())
        self._work, self._prepare = work, prepare
        self._futures: dict[Any, Any] = {}

    def busy(self) -> int:
        """See Crew."""
        return len(self._futures)

    def start(self, job: Any) -> None:  # noqa: ANN401
        """See Crew."""
        future = self._client.submit(_there, self._work, self._prepare, job, pure=False)
        self._futures[future] = job

    def wait(self, seconds: float) -> list[Event]:
        """See Crew."""
        limit = time.monotonic() + seconds
        while not any(future.done() for future in self._futures) and time.monotonic() < limit:
            time.sleep(_LOOK_EVERY)
        events = []
        for future in [future for future in self._futures if future.done()]:
            job = self._futures.pop(future)
            if future.status == "finished":
                events.append(Event(job, "done", future.result()))
            else:
                # The work itself returns its failures: what is left is a worker that was lost.
                events.append(Event(job, "died", 1))
        return events

    def close(self) -> None:
        """See Crew."""
        for future in self._futures:
            future.cancel(force=True)
        self._futures = {}
        self._client.close()


def _there(work: Work, prepare: Prepare, job: Any) -> Any:  # noqa: ANN401
    prepare()
    return work(job, _untold)


def _untold(stage: str, share: float) -> None:
    """Nobody listens."""
