"""Notes to the user that are not errors, issued as warnings."""

from __future__ import annotations

import warnings


class Note(UserWarning):
    """A note to the user, which the command line prints."""


def note(sentence: str) -> None:
    """Issue a note; Python shows the same sentence once a process."""
    warnings.warn(sentence, Note, stacklevel=3)
