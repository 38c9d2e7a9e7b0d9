"""Keeping what decoders print out of the user's terminal.

LibRaw and libpng print "unexpected end of file" and the like straight to file descriptor 2, and
tifffile and exifread log it; the same fault comes back as an exception, and the user reads it
once, as a sentence. What this process itself prints, a progress display say, still gets through.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr

_CHATTY = ("tifffile", "exifread")


class _Silence:
    """Silence with a count: the descriptor belongs to all threads, so the last one gives it back.

    Two that each kept and restored it would leave the process mute for good.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._undo = ExitStack()

    def enter(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                self._begin(self._undo)

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._undo.close()

    @staticmethod
    def _begin(undo: ExitStack) -> None:
        for name in _CHATTY:
            logger, handler = logging.getLogger(name), logging.NullHandler()
            logger.addHandler(handler)  # without any, warnings are printed
            undo.callback(logger.removeHandler, handler)
        try:
            kept = os.dup(2)
        except OSError:  # a process without stderr, a service say, has nothing to keep quiet
            return
        undo.callback(os.close, kept)
        undo.callback(os.dup2, kept, 2)
        if _is_descriptor_2(sys.stderr):
            own = undo.enter_context(
                os.fdopen(kept, "w", buffering=1, closefd=False, errors="replace")
            )
            undo.enter_context(redirect_stderr(own))
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 2)
        os.close(nowhere)


def _is_descriptor_2(stream: object) -> bool:
    try:
        return stream.fileno() == 2  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return False


_silence = _Silence()


@contextmanager
def quiet_decoders() -> Iterator[None]:
    """While inside, in any thread, nothing that decoders print reaches the terminal."""
    _silence.enter()
    try:
        yield
    finally:
        _silence.leave()
