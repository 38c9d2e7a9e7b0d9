"""Thread pool whose threads run PyTorch operators on one core each.

A block is computed on one thread, so that the number of cores changes no bit.
`torch.set_num_threads` sets OpenMP's number for the calling thread, and the default of threads that
are started later. The pool's threads set theirs to 1; then the caller restores the default.

Does not import PyTorch; where it is not loaded nothing needs to be set.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


@contextmanager
def single_threaded(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Context of a pool of `workers` threads, each of which computes on one core."""
    torch = sys.modules.get("torch")
    if torch is None:
        with ThreadPoolExecutor(workers) as pool:
            yield pool
        return
    threads = torch.get_num_threads()
    ready = threading.Barrier(workers + 1)

    def prepare() -> None:
        # The first call makes PyTorch read the default for new threads; otherwise it would do so at
        # the first operator, and overwrite the 1 that is set here.
        torch.get_num_threads()
        torch.set_num_threads(1)
        ready.wait()

    with ThreadPoolExecutor(workers, initializer=prepare) as pool:
        for _ in range(workers):
            pool.submit(_nothing)
        ready.wait()
        torch.set_num_threads(threads)
        yield pool


@contextmanager
def one_thread() -> Iterator[None]:
    """Context, or decorator, in which PyTorch computes on one core for the calling thread.

    For many operators on small tensors, which take twice as much processor time on two cores.
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def compute_alone() -> None:
    """Set PyTorch to one core for this thread and for those it starts."""
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_num_threads(1)


def _nothing() -> None:
    """Empty task, submitted so that the pool starts a thread."""
