"""What a reader notices that is no fault: told once, and the work goes on."""

from __future__ import annotations

import warnings


class Note(UserWarning):
    """A sentence for whoever reads a file; the command line prints it, programs may filter it."""


def note(sentence: str) -> None:
    """Tell it; the same sentence once a process, as Python does with warnings."""
    warnings.warn(sentence, Note, stacklevel=3)
