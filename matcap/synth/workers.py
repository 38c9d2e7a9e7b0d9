"""Worker pool that computes blocks: threads, processes, or a Dask cluster.

Read next: field/single.py (why one thread a block), stream.py (which uses the results).
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from typing import TYPE_CHECKING

from matcap.field.single import compute_alone, single_threaded
from matcap.files.cluster import Cluster
from matcap.files.interrupts import settle_child, starting_children
from matcap.files.memory import keep_memory
from matcap.synth.jobs import (
    BlockResult,
    Future,
    Job,
    WorkerPool,
    rendered,
    unpacked,
)

if TYPE_CHECKING:
    from matcap.field.source import Source

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
