"""Handling of Ctrl-C and SIGTERM: both raise KeyboardInterrupt, but not inside atomic steps."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_BOTH = (signal.SIGINT, signal.SIGTERM)


def raise_on_signals() -> Callable[[], bool]:
    """Make both signals raise KeyboardInterrupt in the main thread, for the whole process.

    Returns:
        A function that returns whether a signal has arrived.
    """
    came: list[int] = []

    def raised(number: int, frame: FrameType | None) -> None:
        came.append(number)
        if _importing("torch"):  # whose C++ aborts at an exception: again when it is done
            again = threading.Timer(0.05, os.kill, (os.getpid(), number))
            again.daemon = True
            again.start()
        else:
            signal.default_int_handler(number, frame)

    for which in _BOTH:
        if signal.getsignal(which) is not signal.SIG_IGN:  # as under nohup
            signal.signal(which, raised)
    return lambda: bool(came)


def _importing(name: str) -> bool:
    """Whether a module's import has begun and not ended."""
    spec = getattr(sys.modules.get(name), "__spec__", None)
    return getattr(spec, "_initializing", False)


def ignore_signals() -> None:
    """Ignore both signals from now on, in a process that is about to end."""
    for which in _BOTH:
        signal.signal(which, signal.SIG_IGN)


@contextmanager
def postponed() -> Iterator[Callable[[], bool]]:
    """Context in which neither signal interrupts, for a few seconds of work that must be complete.

    Yields a function that returns whether a signal has arrived. Signals interrupt the main thread
    only; in other threads the context does nothing.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = {which: signal.getsignal(which) for which in _BOTH}
    for which in _BOTH:
        if before[which] is not signal.SIG_IGN:
            signal.signal(which, lambda number, frame: came.append(number))
    try:
        yield lambda: bool(came)
    finally:
        for which, handler in before.items():
            signal.signal(which, handler or signal.SIG_DFL)


@contextmanager
def starting_children() -> Iterator[None]:
    """Context for starting processes, which inherit blocked signals until settle_child()."""
    with postponed() as came:
        signal.pthread_sigmask(signal.SIG_BLOCK, _BOTH)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _BOTH)
    if came():
        raise KeyboardInterrupt


def settle_child() -> None:
    """Set up a worker process: ignore Ctrl-C, which the main process handles.

    It ends silently at SIGTERM, which process pools send, and with its parent, however that ends.
    """
    from multiprocessing import parent_process

    def follow() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _BOTH)
