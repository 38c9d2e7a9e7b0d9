"""Runs blocks of a field as jobs of a worker pool, in order, a bounded number at a time."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from matcap.field.blocks import BlockPart
from matcap.files.cluster import WorkerLost
from matcap.synth.pictures import texels_of
from matcap.synth.plan import PlannedMapSet
from matcap.synth.preview import lit_from_top

if TYPE_CHECKING:
    from matcap.field.source import Source

T_co = TypeVar("T_co", covariant=True)


class Future(Protocol[T_co]):
    """A future of concurrent.futures or of Dask."""

    def result(self) -> T_co:
        """Wait for the value and return it."""

    def cancel(self) -> object:
        """Cancel it if it has not started."""


@dataclass(frozen=True)
class BlockResult:
    """Result of a job."""

    texels: NDArray[np.void]
    """(rows, columns) texels of the part, in the files' precision."""
    lit: NDArray[np.float16] | None
    """(rows, columns, 3) radiance of the part under a light, if the preview shows it."""


# A part of a block, and the map set that it is written to.
Job = tuple[BlockPart, PlannedMapSet]
Submit = Callable[[Job], Future[BlockResult]]


@dataclass(frozen=True)
class WorkerPool:
    """Running workers."""

    submit: Submit
    """Submits a job."""
    ahead: int
    """Most jobs in flight."""

    def run(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, BlockResult]]:
        """Run the jobs; yield each with its result, in order.

        Raises:
            MatcapError: raised by a job.
            WorkerLost: a worker process was killed.
        """
        pending: deque[tuple[Job, Future[BlockResult]]] = deque()
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


def rendered(source: Source, job: Job) -> BlockResult:
    """Compute the job's part of a block, and light what is shown.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
    """
    part, mapset = job
    planes = source.planes(part.block, mapset.normal)[(..., *part.source)]
    texels = texels_of(planes, source.specular_channels)
    return BlockResult(texels, lit_from_top(planes, mapset.normal) if mapset.shows(part) else None)


@lru_cache(maxsize=2)
def unpacked(packed: bytes) -> Source:
    """Unpickle a source; the last two are cached."""
    return pickle.loads(packed)


def _first(pending: deque[tuple[Job, Future[BlockResult]]]) -> tuple[Job, BlockResult]:
    job, result = pending.popleft()
    return job, result.result()
