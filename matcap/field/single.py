"""Thread pool whose threads compute on one core each.

A block is computed on one thread, so that the machine's count of cores changes no bit. How many
threads PyTorch's operators use is a setting of the calling thread (OpenMP's), beside a number for
threads yet to come that `torch.set_num_threads` writes too; the caller writes that back before
any work begins.

Where PyTorch is not loaded there is no such setting, and nothing here loads it.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


@contextmanager
def single_threaded(workers: int) -> Iterator[ThreadPoolExecutor]:
    """A pool of so many threads, each of which computes on one core."""
    torch = sys.modules.get("torch")
    if torch is None:
        with ThreadPoolExecutor(workers) as pool:
            yield pool
        return
    threads = torch.get_num_threads()
    ready = threading.Barrier(workers + 1)

    def prepare() -> None:
        # The first question makes PyTorch adopt the number for new threads; unasked, it would do
        # so at the first operator, after that number has been written back.
        torch.get_num_threads()
        torch.set_num_threads(1)
        ready.wait()

    with ThreadPoolExecutor(workers, initializer=prepare) as pool:
        for _ in range(workers):
            pool.submit(_nothing)
        ready.wait()
        torch.set_num_threads(threads)
        yield pool


def compute_alone() -> None:
    """Let this thread, and those it starts, compute on one core each."""
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_num_threads(1)


def _nothing() -> None:
    """A task whose submission starts a thread."""
