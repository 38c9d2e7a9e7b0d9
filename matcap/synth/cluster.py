"""Blocks on other machines: a dask.distributed cluster (extra `cluster`).

Blocks are pure functions, so a lost worker's are computed again by another, to the same bits as
long as the machines are of one kind and run one build.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from matcap.errors import MatcapError
from matcap.field.single import single_threaded
from matcap.synth.jobs import Crew, Future, Job, WorkerLost, render_packed
from matcap.synth.pictures import Rendered
from matcap.synth.scheduler import connect

_AHEAD = 2  # blocks in flight for each thread of the cluster


@contextmanager
def cluster(scheduler: str, packed: bytes) -> Iterator[Crew]:
    """The workers of a scheduler.

    Args:
        scheduler: its address, such as tcp://host:8786.
        packed: the source of the blocks.

    Raises:
        MatcapError: the extra is missing, nobody answers at the address, or there is no worker.
    """
    with connect(scheduler) as client:
        threads = sum(client.nthreads().values())
        held = client.scatter(packed, broadcast=True, hash=False)

        def submit(job: Job) -> Future[list[Rendered]]:
            return _Guarded(client.submit(render_single, held, job, pure=False))

        yield Crew(submit, _AHEAD * max(threads, 1))


def render_single(packed: bytes, job: Job) -> list[Rendered]:
    """The job on one thread, whatever kind of worker this is."""
    with single_threaded(1) as pool:
        return pool.submit(render_packed, packed, job).result()


class _Guarded:
    """A cluster's future, whose end without a result is an error one can act upon."""

    def __init__(self, future: Any) -> None:  # noqa: ANN401
        self._future = future

    def result(self) -> list[Rendered]:
        """The value, when it is there."""
        try:
            found: list[Rendered] = self._future.result()
            return found
        except MatcapError:
            raise
        except Exception as error:
            raise WorkerLost(
                f"the cluster could not compute a block ({error})",
                remedy="look at its workers, and go on with --resume",
            ) from error

    def cancel(self) -> bool:
        """Forget about it."""
        return bool(self._future.cancel())
