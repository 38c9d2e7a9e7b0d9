"""All that synthesis looks up, level by level: made from an exemplar and its index.

A level is a grid of output places 2^level texels apart. Neighbouring places are compared by the
appearance of the exemplar smoothed to that spacing, at places known to half a step.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.appearance import Appearance, project
from matcap.example.exemplar import Exemplar
from matcap.example.features import features_of, planes_of
from matcap.example.grids import Frame, frame_of, grid_bits, grids_of, similar_bits
from matcap.example.index import Index
from matcap.example.order import Order, Phases
from matcap.example.piece_sizes import PieceSizes
from matcap.example.tuned import LOOKUP


@dataclass(frozen=True)
class Level:
    """What one level looks up."""

    spacing: int
    """Texels between places of the output."""
    frame: Frame
    """Of the places."""
    bits: int
    """The appearance's grid is 2^bits texels wide."""
    appearance: Appearance
    """(H, W, DIMENSIONS) int16."""
    similar_bits: int
    """The grid of similar places is 2^similar_bits texels wide."""
    similar: NDArray[np.int16]
    """(H, W, 2) int16 x, y in texels."""
    placement_cost: NDArray[np.int32]
    """(H, W) int32 placement cost of squares of 2^PRICE_BITS texels, added to the mismatch."""
    phases: Phases | None
    """(H, W, 2) of the appearance's grid, where there is order to keep."""


@dataclass(frozen=True)
class Lookup:
    """Levels, the finest first, the order they keep, and the pieces they begin with."""

    levels: tuple[Level, ...]
    order: Order | None
    sizes: PieceSizes


def prepare(exemplar: Exemplar, index: Index, variety: float = 1.0) -> Lookup:
    """What an exemplar and its index are looked up in.

    Args:
        exemplar: that the index is of.
        index: of it.
        variety: of the field, in [0, 1].
    """
    width, height = exemplar.size
    features = features_of(planes_of(exemplar), index.scale)
    grids = grids_of(features, len(index.bases))
    with ThreadPoolExecutor() as pool:
        appearances = list(pool.map(project, grids, index.bases))
    price = np.square(index.reluctance, dtype=np.int32) << LOOKUP.cost_bits
    levels = tuple(
        Level(
            spacing=1 << level,
            frame=frame_of(level, width, height),
            bits=grid_bits(level),
            appearance=appearance,
            similar_bits=similar_bits(level),
            similar=similar,
            placement_cost=price,
            phases=_phases(index.order, level, appearance),
        )
        for level, (appearance, similar) in enumerate(zip(appearances, index.similar, strict=True))
    )
    sizes = PieceSizes.of(levels[-1].frame, levels[-1].spacing, index.order, variety)
    return Lookup(levels, index.order, sizes)


def _phases(order: Order | None, level: int, appearance: Appearance) -> Phases | None:
    if order is None or level < LOOKUP.ordered:
        return None
    rows, columns = (np.arange(n) << grid_bits(level) for n in appearance.shape[:2])
    return two_phases(order.phases(columns[None, :], rows[:, None]))


def two_phases(phases: Phases) -> Phases:
    """(..., 2): the second of one wave is always nought."""
    return np.pad(phases, ((0, 0), (0, 0), (0, 2 - phases.shape[-1])))
