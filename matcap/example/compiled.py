"""The two inner loops, compiled, where they were built: as appearance.project and plain.correct."""

from __future__ import annotations

import ctypes
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.example.appearance import DIMENSIONS, Appearance, Basis, padded
from matcap.example.features import FeatureMap
from matcap.example.lookup import Level
from matcap.example.order import Phases
from matcap.example.plain import Places, margin

_FORM = 2  # of kernel.c


class _Level(ctypes.Structure):
    _fields_ = (
        ("appearance", ctypes.c_void_p),
        ("price", ctypes.c_void_p),
        ("similar", ctypes.c_void_p),
        ("phases", ctypes.c_void_p),
        *(
            (name, ctypes.c_int32)
            for name in (
                "columns", "similar_columns", "price_columns", "bits", "similar_bits", "spacing",
                "left", "top", "right", "bottom",
            )
        ),
    )  # fmt: skip


@cache
def kernel() -> Any | None:  # noqa: ANN401
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


def project(features: FeatureMap, basis: Basis) -> Appearance:
    """As appearance.project."""
    library = kernel()
    assert library is not None
    rows, columns = features.shape[1:]
    around = np.ascontiguousarray(padded(features, basis).transpose(1, 2, 0))
    weights = np.ascontiguousarray(basis.weights, np.int16)
    found = np.empty((rows, columns, DIMENSIONS), np.int16)
    library.matcap_project(
        _address(around), _address(weights), basis.step, basis.shift, columns, rows, _address(found)
    )
    return found


def correct(
    places: Places,
    level: Level,
    odd_columns: NDArray[np.bool_],
    odd_rows: NDArray[np.bool_],
    passes: int,
    phases: Phases | None = None,
) -> Places:
    """As plain.correct."""
    library = kernel()
    assert library is not None
    places = np.ascontiguousarray(places).copy()
    phases = None if phases is None else np.ascontiguousarray(phases)
    scratch = np.empty_like(places)
    frame = level.frame
    told = _Level(
        level.appearance.ctypes.data, level.price.ctypes.data, level.similar.ctypes.data,
        None if level.phases is None else level.phases.ctypes.data,
        level.appearance.shape[1], level.similar.shape[1], level.price.shape[1],
        level.bits, level.similar_bits, level.spacing,
        frame.left, frame.top, frame.right, frame.bottom,
    )  # fmt: skip
    rows, columns = places.shape[:2]
    odd_columns, odd_rows = odd_columns.astype(np.uint8), odd_rows.astype(np.uint8)
    library.matcap_correct(
        ctypes.byref(told), _address(places), _address(scratch), columns, rows,
        _address(odd_columns), _address(odd_rows), passes,
        None if phases is None else _address(phases),
    )  # fmt: skip
    cut = margin(passes)
    return places[cut : rows - cut, cut : columns - cut]


def _address(array: NDArray[Any]) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)
