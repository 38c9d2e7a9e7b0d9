"""Correction passes: coordinates are replaced by better-fitting candidates; a compiled loop."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from matcap.example.library import address, loops
from matcap.example.lookup import Level
from matcap.example.order import Phases

Places = NDArray[np.int16]  # (rows, columns, 2): x, y of the exemplar

# Of kernel.c. There a tenth of a turn costs as much as a seam that is seen, and what is merely
# similar must fit twice better than what continues a piece, so that pieces stay large.
SUBPASSES = ((0, 0), (1, 1), (0, 1), (1, 0))  # (row, column) parity of the places each one corrects
REACH = 2  # places that a sub-pass looks around itself


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


def correct(
    places: Places,
    level: Level,
    odd_columns: NDArray[np.bool_],
    odd_rows: NDArray[np.bool_],
    passes: int,
    phases: Phases | None = None,
) -> Places:
    """Places that fit their neighbours better.

    A place whose neighbours all continue it stays. Any other takes the best of what its
    neighbours and it itself would be continued by, and of what is most similar to those, by the
    appearance of its diagonal neighbours; each of these is the mean of three neighbours that
    would continue to there. Of equals the first wins, and what continues a neighbour before what
    is similar.

    Args:
        places: (rows, columns, 2).
        level: what to look up.
        odd_columns, odd_rows: parity of every column and row of the field.
        passes: of four sub-passes each.
        phases: (rows, columns, 2) of the order that the field is to have.

    Returns:
        (rows - 2 m, columns - 2 m, 2) with m = margin(passes).

    Raises:
        MatcapError: the loops were not built.
    """
    places = np.ascontiguousarray(places).copy()
    phases = None if phases is None else np.ascontiguousarray(phases)
    scratch = np.empty_like(places)
    frame = level.frame
    c_level = _Level(
        level.appearance.ctypes.data, level.placement_cost.ctypes.data, level.similar.ctypes.data,
        None if level.phases is None else level.phases.ctypes.data,
        level.appearance.shape[1], level.similar.shape[1], level.placement_cost.shape[1],
        level.bits, level.similar_bits, level.spacing,
        frame.left, frame.top, frame.right, frame.bottom,
    )  # fmt: skip
    rows, columns = places.shape[:2]
    odd_columns, odd_rows = odd_columns.astype(np.uint8), odd_rows.astype(np.uint8)
    loops().matcap_correct(
        ctypes.byref(c_level), address(places), address(scratch), columns, rows,
        address(odd_columns), address(odd_rows), passes,
        None if phases is None else address(phases),
    )  # fmt: skip
    cut = margin(passes)
    return places[cut : rows - cut, cut : columns - cut]


def margin(passes: int) -> int:
    """Places that a correction reads beyond those it gives, on every side."""
    return REACH * len(SUBPASSES) * passes
