"""Rectangles of a field as jobs for a worker pool; in order, a bounded number at a time."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol, TypeVar

from matcap.field.blocks import BlockPart
from matcap.files.cluster import WorkerLost
from matcap.synth.pictures import Rendered, render
from matcap.synth.plan import PlannedMapSet

if TYPE_CHECKING:
    from matcap.field.source import Source

T_co = TypeVar("T_co", covariant=True)


class Future(Protocol[T_co]):
    """A future, of whatever library."""

    def result(self) -> T_co:
        """The value, when it is there."""
        ...

    def cancel(self) -> object:
        """Forget about it."""
        ...


# A piece of the field, and the map set that it goes into.
Job = tuple[BlockPart, PlannedMapSet]
Submit = Callable[[Job], Future[list[Rendered]]]


@dataclass(frozen=True)
class WorkerPool:
    """Workers that stand ready."""

    submit: Submit
    """Gives them a job."""
    ahead: int
    """How many jobs are in flight at most."""

    def run(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, list[Rendered]]]:
        """Results in the order of their jobs.

        Raises:
            MatcapError: of the jobs; a worker process was killed.
        """
        pending: deque[tuple[Job, Future[list[Rendered]]]] = deque()
        try:
            for job in jobs:
                pending.append((job, self.submit(job)))
                if len(pending) >= self.ahead:
                    yield _first(pending)
            while pending:
                yield _first(pending)
        except BrokenProcessPool as error:
            raise WorkerLost(
                "a worker process was killed",
                remedy="free some memory or ask for fewer with -j, and go on with --resume",
            ) from error
        finally:
            for _, result in pending:
                result.cancel()


def rendered(source: Source, job: Job) -> list[Rendered]:
    """The job's piece, computed and encoded for each picture."""
    piece, mapset = job
    return render(source, piece, mapset.pictures, mapset.normal)


def pack(source: Source) -> bytes:
    """A source to be sent elsewhere."""
    return pickle.dumps(source)


def render_packed(packed: bytes, job: Job) -> list[Rendered]:
    """The job, wherever this runs."""
    return rendered(unpacked(packed), job)


@lru_cache(maxsize=2)
def unpacked(packed: bytes) -> Source:
    """The source that was packed."""
    source: Source = pickle.loads(packed)
    return source


def _first(pending: deque[tuple[Job, Future[list[Rendered]]]]) -> tuple[Job, list[Rendered]]:
    job, result = pending.popleft()
    return job, result.result()
