"""Ctrl-C and SIGTERM: both end a command alike, and never inside an atomic step."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_BOTH = (signal.SIGINT, signal.SIGTERM)


def end_alike() -> Callable[[], bool]:
    """Have both raise KeyboardInterrupt in the main thread; gives a function: whether one came.

    For a process of its own.
    """
    came: list[int] = []

    def raised(number: int, frame: FrameType | None) -> None:
        came.append(number)
        signal.default_int_handler(number, frame)

    for which in _BOTH:
        if signal.getsignal(which) is not signal.SIG_IGN:  # as under nohup
            signal.signal(which, raised)
    return lambda: bool(came)


def ignore_both() -> None:
    """From here on neither changes anything: the process is about to end by itself."""
    for which in _BOTH:
        signal.signal(which, signal.SIG_IGN)


@contextmanager
def postponed() -> Iterator[Callable[[], bool]]:
    """Neither interrupts the block; the block receives a function that says whether one came.

    For seconds of work that must be whole. In other threads than the main one nothing interrupts.
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
    """Processes started meanwhile begin undisturbed, and receive their role.

    They inherit that both are held back, until they call `settle_child`.
    """
    with postponed() as came:
        signal.pthread_sigmask(signal.SIG_BLOCK, _BOTH)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _BOTH)
    if came():
        raise KeyboardInterrupt


def settle_child() -> None:
    """In a worker process: Ctrl-C reaches every process of the terminal, and the main one decides.

    SIGTERM ends it without a word, as pools of processes want.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _BOTH)
