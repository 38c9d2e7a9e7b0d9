"""The compiled loops (kernel.c), found where they were built; tests hold them to plain ones."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from matcap.files.compiled import find_library, not_built

_FORM = 3  # of kernel.c


@cache
def built() -> Any | None:  # noqa: ANN401
    """The library, or None where it was not built, or from another form of its file."""
    return find_library(Path(__file__).parent, ("matcap_form", _FORM))


def loops() -> Any:  # noqa: ANN401
    """The library.

    Raises:
        MatcapError: it was not built.
    """
    library = built()
    if library is None:
        raise not_built("fields by example")
    return library


def address(array: NDArray[Any]) -> ctypes.c_void_p:
    """Of an array that is read or written."""
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)
