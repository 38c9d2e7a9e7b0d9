"""Whole samples on other machines: a crew of dask.distributed workers (extra `cluster`).

Every machine must see the shoot and the output under the same names. Progress inside a sample is
not told, only its end.
"""

from __future__ import annotations

import time
from typing import Any

from matcap.batch.crew import DoWork, Event, Prepare
from matcap.files.progress import nobody
from matcap.synth.scheduler import connect

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

    def __init__(self, scheduler: str, work: DoWork, prepare: Prepare) -> None:
        self._client = connect(scheduler, "dask worker --nthreads 1")
        self.size = sum(self._client.nthreads().values())
        self._work, self._prepare = work, prepare
        self._futures: dict[Any, Any] = {}

    def busy(self) -> int:
        """See BatchCrew."""
        return len(self._futures)

    def start(self, job: Any) -> None:  # noqa: ANN401
        """See BatchCrew."""
        future = self._client.submit(_there, self._work, self._prepare, job, pure=False)
        self._futures[future] = job

    def wait(self, seconds: float) -> list[Event]:
        """See BatchCrew."""
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
        """See BatchCrew."""
        for future in self._futures:
            future.cancel(force=True)
        self._futures = {}
        self._client.close()


def _there(work: DoWork, prepare: Prepare, job: Any) -> Any:  # noqa: ANN401
    prepare()
    return work(job, nobody)
