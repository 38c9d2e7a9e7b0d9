"""Correction of synthesised coordinates [lefebvre2005] with k-coherence candidates [tong2002]."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from matcap.example.lattice import Phases
from matcap.example.library import address, loops
from matcap.example.lookup import Level

Places = NDArray[np.int16]  # (rows, columns, 2): x, y of the exemplar

# As in kernel.c. A phase error of a tenth of a turn costs as much as a visible seam. The mismatch
# of k-coherence candidates counts twice, so that patches stay large.
SUBPASSES = ((0, 0), (1, 1), (0, 1), (1, 0))  # (row, column) parity of the places each one corrects
REACH = 2  # radius in places of the neighbourhood that a sub-pass reads


class _Level(ctypes.Structure):
    _fields_ = (
        ("appearance", ctypes.c_void_p),
        ("placement_cost", ctypes.c_void_p),
        ("similar", ctypes.c_void_p),
        ("phases", ctypes.c_void_p),
        *(
            (name, ctypes.c_int32)
            for name in (
                "columns", "similar_columns", "cost_columns", "bits", "similar_bits", "spacing",
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
    """Replace places by candidates that match their neighbourhood better.

    A place that continues all its neighbours is kept. Otherwise candidates are the continuations of
    the place itself and of its eight neighbours (the neighbour's place minus its offset), and for
    each of these its k-coherence candidate. The cost is the squared difference of appearance at the
    four diagonal neighbours, whose wanted appearance is the mean of what three of their neighbours
    continue to there; plus phase error and placement cost. Of equal costs the first candidate wins,
    continuations first.

    Args:
        places: (rows, columns, 2).
        level: appearance, candidates and costs.
        odd_columns, odd_rows: whether each column and row of the field is odd.
        passes: number of passes, of four sub-passes each.
        phases: (rows, columns, 2) of the ideal lattice, or None.

    Returns:
        (rows - 2 m, columns - 2 m, 2) with m = margin(passes).

    Raises:
        MatcapError: the compiled loops are missing.
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
    """Places that a correction reads beyond those it returns, on every side."""
    return REACH * len(SUBPASSES) * passes
