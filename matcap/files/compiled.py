"""Compiled loops, found where they were built: beside the files that call them."""

from __future__ import annotations

import ctypes
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

from matcap.errors import MatcapError


def find_library(folder: Path, form: tuple[str, int]) -> Any | None:  # noqa: ANN401
    """The library of a folder, or None where it was not built, or from other files.

    Args:
        folder: that holds kernel.c and what was built of it.
        form: name of the function that returns its interface version, and the expected one.
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
    """The sentence where there is none."""
    return MatcapError(
        f"the compiled loops of {what} were not built when matcap was installed",
        remedy="install a C compiler (gcc, clang or MSVC) and then matcap again",
    )
