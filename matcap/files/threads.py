"""Threads of one core each: independent work at once, with the same bits on any number of cores.

PyTorch's sums depend on how many threads share an operator. So work is divided here, by places that
do not depend on the number of cores, and every thread computes its part alone.

Does not import PyTorch; where it is not loaded nothing needs to be set.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import copy_context
from functools import cache, partial
from typing import Any, TypeVar, overload

from matcap.files.process import cores, importing

A = TypeVar("A")
B = TypeVar("B")
C = TypeVar("C")


def workers() -> int:
    """Number of threads that compute at once: OMP_NUM_THREADS, else the cores of this process."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    return int(limit) if limit.isdecimal() and int(limit) > 0 else cores()


@overload
def at_once(first: Callable[[], A], second: Callable[[], B], /) -> tuple[A, B]: ...


@overload
def at_once(
    first: Callable[[], A], second: Callable[[], B], third: Callable[[], C], /
) -> tuple[A, B, C]: ...


@overload
def at_once(*tasks: Callable[[], A]) -> tuple[A, ...]: ...


def at_once(*tasks: Callable[[], Any]) -> tuple[Any, ...]:
    """Results of tasks that do not depend on one another, computed on as many threads as workers().

    The calling thread takes part, first with the first, and tasks may call this function in turn:
    no more threads compute than workers(). A task has the caller's context variables and PyTorch's
    gradient modes, and computes on one core.

    Raises:
        An error of the tasks, or KeyboardInterrupt in the main thread: then tasks that have not
        begun are left out, and those that have are waited for.
    """
    threads = workers()
    with one_thread():
        if threads == 1 or len(tasks) < 2:
            return tuple(task() for task in tasks)
        begun = [_helpers(threads - 1).submit(_alike(task)) for task in tasks[1:]]
        failed: list[Future[Any]] = []
        for future in begun:
            future.add_done_callback(lambda one: failed.extend([one] if _fails(one) else []))
        try:
            done = {0: tasks[0]()}
            for number in range(len(begun), 0, -1):  # helpers begin with the first
                if not failed and begun[number - 1].cancel():
                    done[number] = tasks[number]()
            for future in failed:
                future.result()
            return tuple(
                done[number] if number in done else begun[number - 1].result()
                for number in range(len(tasks))
            )
        finally:
            wait([future for future in begun if not future.cancel()])


def _fails(future: Future[Any]) -> bool:
    return not future.cancelled() and future.exception() is not None


@cache
def _helpers(number: int) -> ThreadPoolExecutor:
    """The threads that take part, started when they are first needed."""
    return ThreadPoolExecutor(number, thread_name_prefix="at once")


os.register_at_fork(after_in_child=_helpers.cache_clear)  # its threads are the parent's


def _alike(task: Callable[[], A]) -> Callable[[], A]:
    """A task that runs in a helping thread as it would in the calling one, on one core."""
    torch = _loaded()
    modes = torch and (torch.is_grad_enabled(), torch.is_inference_mode_enabled())

    def run() -> A:
        with one_thread():
            if torch is None or modes is None:
                return task()
            gradients, inference = modes
            with torch.inference_mode(inference), torch.set_grad_enabled(gradients):
                return task()

    return partial(copy_context().run, run)


def _loaded() -> Any | None:  # noqa: ANN401
    """PyTorch, unless it is not imported, or a thread is importing it."""
    torch = sys.modules.get("torch")  # before the question, as an import may begin in between
    return None if importing("torch") else torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Context, or decorator, in which PyTorch computes on one core for the calling thread.

    For sums, and for many operators on small tensors, which take twice as much processor time on
    two cores.
    """
    with computing(1):
        yield


@contextmanager
def computing(number: int) -> Iterator[None]:
    """Context in which PyTorch computes on a number of threads for the calling thread."""
    torch = _loaded()
    if torch is None:
        yield
        return
    # The first call makes PyTorch read the default for new threads; otherwise it would do so at
    # the first operator, and overwrite the number that is set here.
    threads = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def single_threaded(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Context of a pool of `workers` threads, each of which computes on one core.

    `torch.set_num_threads` sets OpenMP's number for the calling thread, and the default of threads
    that are started later. The pool's threads set theirs to 1; then the caller restores the
    default.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        with ThreadPoolExecutor(workers) as pool:
            yield pool
        return
    threads = torch.get_num_threads()
    ready = threading.Barrier(workers + 1)

    def prepare() -> None:
        torch.get_num_threads()  # as in one_thread
        torch.set_num_threads(1)
        ready.wait()

    with ThreadPoolExecutor(workers, initializer=prepare) as pool:
        for _ in range(workers):
            pool.submit(int)  # an empty task, so that the pool starts a thread
        ready.wait()
        torch.set_num_threads(threads)
        yield pool


def compute_alone() -> None:
    """Make this process, one of several workers, compute on one core: PyTorch as at_once."""
    os.environ["OMP_NUM_THREADS"] = "1"
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_num_threads(1)
