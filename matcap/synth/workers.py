"""Blocks of a field computed by threads, processes or a Dask cluster, in order."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import get_context
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from matcap.field.plane import BlockPart
from matcap.field.source import compute_alone, single_threaded
from matcap.files.process import Cluster, WorkerLost, keep_memory, settle_child, starting_children
from matcap.synth.pictures import lit_from_top, texels_of
from matcap.synth.plan import PlannedMapSet

if TYPE_CHECKING:
    from matcap.field.source import Source


# Runs blocks of a field as jobs of a worker pool, in order, a bounded number at a time.


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


# Worker pool that computes blocks: threads, processes, or a Dask cluster.
#
# Read next: field/source.py (why one thread a block), stream.py (which uses the results).


_AHEAD = 2  # blocks in flight for each worker: one computed, one waiting
_FEW = 24  # up to so many blocks, threads are done before processes have started


@contextmanager
def worker_pool(
    source: Source, workers: int, jobs: int, scheduler: str | None = None
) -> Iterator[WorkerPool]:
    """Context of a worker pool: a cluster, processes, or threads for few jobs and on CUDA.

    Threads share a CUDA device, and encode tiles in parallel.

    Args:
        workers: number of processes or threads.
        jobs: upper bound of the number of jobs.
        scheduler: address of a Dask scheduler, whose workers are used instead.

    Raises:
        MatcapError: no scheduler answers, or Dask is not installed.
    """
    if scheduler is not None:
        with Cluster(scheduler) as machines:
            shared_source = machines.shared(pickle.dumps(source))
            yield WorkerPool(
                partial(machines.submit, _render_alone, shared_source), _AHEAD * machines.threads
            )
    elif workers == 1 or jobs <= _FEW or source.device_type != "cpu":
        with single_threaded(workers) as pool:
            yield WorkerPool(lambda job: pool.submit(rendered, source, job), _AHEAD * workers)
    else:
        processes = ProcessPoolExecutor(
            workers,
            mp_context=get_context("spawn"),
            initializer=_prepare,
            initargs=(pickle.dumps(source),),
        )
        try:
            yield WorkerPool(partial(_submit, processes), _AHEAD * workers)
        finally:
            processes.shutdown(cancel_futures=True)


def _submit(processes: ProcessPoolExecutor, job: Job) -> Future[BlockResult]:
    """Submit a job to a pool, which may start a process for it."""
    with starting_children():
        return processes.submit(_render_here, job)


def _render_alone(packed: bytes, job: Job) -> BlockResult:
    """Run a job on one thread of a cluster's worker."""
    with single_threaded(1) as pool:
        return pool.submit(rendered, unpacked(packed), job).result()


def _render_here(job: Job) -> BlockResult:
    """Run a job in a worker process."""
    return rendered(_task[0], job)


# The source, in a worker process; empty in any other.
_task: list[Source] = []


def _prepare(packed: bytes) -> None:
    """Set up a worker process: one thread, kept memory, and exit with its parent."""
    _task.append(unpacked(packed))
    compute_alone()
    keep_memory()
    settle_child()
