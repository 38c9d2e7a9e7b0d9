"""Suppresses the messages that decoders print to the terminal.

LibRaw and libpng print errors to file descriptor 2, tifffile and exifread log them; the same errors
are raised as exceptions. Output of this process to sys.stderr, such as progress, is not suppressed.
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
    """Redirection of descriptor 2, shared by all threads: begun by the first, ended by the last.

    If each thread saved and restored it, an overlap could leave it redirected.
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
        except OSError:  # a process without stderr, such as a service
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
    """Context in which messages of decoders are suppressed, in all threads."""
    _silence.enter()
    try:
        yield
    finally:
        _silence.leave()
