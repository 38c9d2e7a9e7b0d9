"""Notes of readers on what is no error: issued once, and the work goes on."""

from __future__ import annotations

import warnings


class Note(UserWarning):
    """A note to the user; the command line prints it, programs may filter it."""


def note(sentence: str) -> None:
    """Issue a note; the same sentence once a process, as Python does with warnings."""
    warnings.warn(sentence, Note, stacklevel=3)
