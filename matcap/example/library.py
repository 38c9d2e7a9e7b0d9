"""The compiled loops (kernel.c), found where they were built; tests hold them to plain ones."""

from __future__ import annotations

import ctypes
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from matcap.errors import MatcapError

_FORM = 2  # of kernel.c


@cache
def built() -> Any | None:  # noqa: ANN401
    """The library, or None where it was not built, or from another form of its file."""
    for suffix in EXTENSION_SUFFIXES:
        path = Path(__file__).with_name(f"kernel{suffix}")
        if path.is_file():
            try:
                library = ctypes.CDLL(str(path))
                if library.matcap_form() == _FORM:
                    return library
            except (OSError, AttributeError):
                continue
    return None


def loops() -> Any:  # noqa: ANN401
    """The library.

    Raises:
        MatcapError: it was not built.
    """
    library = built()
    if library is None:
        raise MatcapError(
            "the compiled loops of fields by example were not built when matcap was installed",
            remedy="install a C compiler (gcc, clang or MSVC) and then matcap again",
        )
    return library


def address(array: NDArray[Any]) -> ctypes.c_void_p:
    """Of an array that is read or written."""
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)
