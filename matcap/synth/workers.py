"""Who computes the blocks: threads, processes, or a cluster; always in order, never many at once.

Read next: single.py (why one thread a block), stream.py (what becomes of the results).
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, TypeVar

import torch

from matcap.errors import MatcapError
from matcap.export.mapset import NormalStyle
from matcap.synth.blocks import Piece
from matcap.synth.pictures import Picture, Rendered, render
from matcap.synth.single import single_threaded
from matcap.synth.source import Source

_AHEAD = 2  # blocks in flight for each worker: one computed, one waiting
_FEW = 24  # blocks that are done before processes have started
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # malloc.h

T_co = TypeVar("T_co", covariant=True)


class WorkerLost(MatcapError):
    """A worker died; what the others finished is kept for another try."""


class Result(Protocol[T_co]):
    """A future, of whatever library."""

    def result(self) -> T_co:
        """The value, when it is there."""
        ...

    def cancel(self) -> object:
        """Forget about it."""
        ...


@dataclass(frozen=True)
class Job:
    """A piece of the field, and the pictures it goes into."""

    piece: Piece
    pictures: tuple[Picture, ...]
    normal: NormalStyle


Submit = Callable[[Job], Result[list[Rendered]]]


@dataclass(frozen=True)
class Crew:
    """Workers that stand ready.

    Attributes:
        submit: gives them a job.
        ahead: how many jobs are in flight at most.
    """

    submit: Submit
    ahead: int

    def run(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, list[Rendered]]]:
        """Results in the order of their jobs.

        Raises:
            MatcapError: of the jobs; a worker process was killed.
        """
        pending: deque[tuple[Job, Result[list[Rendered]]]] = deque()
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


@contextmanager
def crew(source: Source, workers: int, jobs: int, scheduler: str | None = None) -> Iterator[Crew]:
    """Workers for so many jobs: a cluster's, processes, or threads where that is faster.

    A CUDA device serves one process: threads take turns at it and encode tiles side by side.

    Args:
        source: what they compute.
        workers: how many processes or threads.
        jobs: how many jobs there will be, at most.
        scheduler: a dask scheduler's address instead.

    Raises:
        MatcapError: there is no such scheduler, or the extra is missing.
    """
    if scheduler is not None:
        from matcap.synth.cluster import cluster

        with cluster(scheduler, pack(source)) as ready:
            yield ready
    elif workers == 1 or jobs <= _FEW or source.device.type != "cpu":
        with single_threaded(workers) as pool:
            yield Crew(
                lambda job: pool.submit(render, source, job.piece, job.pictures, job.normal),
                _AHEAD * workers,
            )
    else:
        processes = ProcessPoolExecutor(
            workers, mp_context=get_context("spawn"), initializer=_prepare, initargs=(pack(source),)
        )
        try:
            yield Crew(lambda job: processes.submit(_render_here, job), _AHEAD * workers)
        finally:
            processes.shutdown(cancel_futures=True)


def pack(source: Source) -> bytes:
    """A source to be sent elsewhere."""
    return pickle.dumps(source)


def render_packed(packed: bytes, job: Job) -> list[Rendered]:
    """The job, wherever this runs."""
    return render(_unpacked(packed), job.piece, job.pictures, job.normal)


def _render_here(job: Job) -> list[Rendered]:
    """The job, in a worker process."""
    return render(_task[0], job.piece, job.pictures, job.normal)


@lru_cache(maxsize=2)
def _unpacked(packed: bytes) -> Source:
    source: Source = pickle.loads(packed)
    return source


def _first(pending: deque[tuple[Job, Result[list[Rendered]]]]) -> tuple[Job, list[Rendered]]:
    job, result = pending.popleft()
    return job, result.result()


# What a worker process was started for; empty in every other.
_task: list[Source] = []


def _prepare(packed: bytes) -> None:
    """Settle a worker process: one thread, kept memory, and no life after its parent."""
    _task.append(_unpacked(packed))
    torch.set_num_threads(1)
    keep_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True).start()


def _follow(parent: BaseProcess) -> None:
    """End with the parent, even one that was killed: nobody would end this process then."""
    parent.join()
    os._exit(1)


def keep_memory() -> None:
    """Tell glibc to reuse large buffers rather than to fetch them fresh from the system.

    For a process of its own: it holds for all of it, and for threads that are yet to come.
    Elsewhere than on glibc nothing happens.
    """
    library: Any = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_MMAP_THRESHOLD, 1 << 30)
        library.mallopt(_M_TRIM_THRESHOLD, 1 << 30)
        # A thread's own heap holds 64 MB at most: larger buffers would be fetched fresh again.
        library.mallopt(_M_ARENA_MAX, 1)
