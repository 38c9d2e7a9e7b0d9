"""Loads compiled loops from the folders of their sources."""

from __future__ import annotations

import ctypes
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

from matcap.errors import MatcapError


def find_library(folder: Path, form: tuple[str, int]) -> Any | None:  # noqa: ANN401
    """Load the library of a folder; None if it is missing or of another interface version.

    Args:
        folder: with kernel.c and the library built from it.
        form: name of the function that returns the interface version, and the expected version.
    """
    name, expected = form
    for suffix in EXTENSION_SUFFIXES:
        path = folder / f"kernel{suffix}"
        if path.is_file():
            try:
                library = ctypes.CDLL(str(path))
                if getattr(library, name)() == expected:
                    return library
            except (OSError, AttributeError):
                continue
    return None


def not_built(what: str) -> MatcapError:
    """The error for a missing library."""
    return MatcapError(
        f"the compiled loops of {what} were not built when matcap was installed",
        remedy="install a C compiler (gcc, clang or MSVC) and then matcap again",
    )
