"""Loads the compiled loops, and passes arrays to them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from matcap.files.compiled import find_library, not_built
from matcap.relight.vectors import Array

# As in loops.h.
_FORM = 3
LANES, CHANNELS, AZIMUTHS = 8, 9, 16

Pointer, Whole, Real = ctypes.c_void_p, ctypes.c_int32, ctypes.c_float


@cache
def built() -> Any | None:  # noqa: ANN401
    """The library; None where it was not built, or from another version of its sources (_FORM)."""
    return find_library(Path(__file__).parent, ("matcap_relight_form", _FORM))


def loops() -> Any:  # noqa: ANN401
    """The library.

    Raises:
        MatcapError: it was not built from these sources.
    """
    library = built()
    if library is None:
        raise not_built("relighting")
    return library


class KeptArrays:
    """Keeps NumPy arrays alive while C code holds their addresses."""

    def __init__(self) -> None:
        self._arrays: list[Array] = []

    def of(self, values: Array | Sequence[float], dtype: type = np.float32) -> int:
        """Address of values as a C-contiguous array of a dtype; copies only if they are not."""
        array: Array = np.ascontiguousarray(values, dtype=dtype)
        self._arrays.append(array)
        return array.ctypes.data

    def kept_by(self, structure: Holder) -> Holder:
        """The structure, which keeps the arrays alive from now on."""
        structure.kept = self
        return structure


class ArrayStructure(ctypes.Structure):
    """A C structure that points to arrays."""

    kept: KeptArrays
    """Keeps them alive."""


Holder = TypeVar("Holder", bound=ArrayStructure)


def address(array: Array) -> Any:  # noqa: ANN401
    """Pointer to a C-contiguous array that the loops write to."""
    assert array.flags.c_contiguous
    return Pointer(array.ctypes.data)
