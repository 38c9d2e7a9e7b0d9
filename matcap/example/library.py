"""Loads the compiled loops (kernel.c)."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from matcap.files.compiled import find_library, not_built

_FORM = 3  # version of kernel.c's interface


@cache
def built() -> Any | None:  # noqa: ANN401
    """The library, or None if it is missing or of another version."""
    return find_library(Path(__file__).parent, ("matcap_form", _FORM))


def loops() -> Any:  # noqa: ANN401
    """The library.

    Raises:
        MatcapError: it is missing or of another version.
    """
    library = built()
    if library is None:
        raise not_built("fields by example")
    return library


def address(array: NDArray[Any]) -> ctypes.c_void_p:
    """Pointer to a contiguous array's data."""
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)
