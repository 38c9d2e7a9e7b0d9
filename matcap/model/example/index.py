"""Index of an exemplar: all that synthesis looks up, level by level.

A level is a grid of output places 2^level texels apart. Neighbouring places are compared by the
appearance of the exemplar smoothed to that spacing, at places known to half a step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.model.example.appearance import Appearance, choose_basis, project
from matcap.model.example.features import (
    Features,
    choose_scale,
    features_of,
    halved,
    planes_of,
    smoothed,
)
from matcap.model.example.order import Order, Phases, Wave, measure_order
from matcap.model.example.similar import Similar, find_similar
from matcap.model.exemplar import Exemplar

MOST_LEVELS = 5  # periods are multiples of 2^4 texels, as the decoder's
_MARGIN = 3  # steps between a place and the exemplar's border: beyond, there is no neighbourhood
_ROOM = 8  # steps of the coarsest level that an exemplar is at least wide
_ORDERED = 1  # levels from this one on keep to the order
_FINENESS = 16  # places of the coarsest level along the shorter side of a lattice's piece
_APART = 4  # steps between a place and what is similar to it


@dataclass(frozen=True)
class Frame:
    """Where places of a level may lie, in the exemplar's texels, ends included."""

    left: int
    top: int
    right: int
    bottom: int


@dataclass(frozen=True)
class Level:
    """What one level looks up.

    Attributes:
        spacing: texels between places of the output.
        frame: of the places.
        bits: the appearance's grid is 2^bits texels wide.
        appearance: (H, W, DIMENSIONS) int16.
        price: (H, W) int32 of a place, beside how well it fits.
        similar_bits: the grid of similar places is 2^similar_bits texels wide.
        similar: (H, W, 2) int16 x, y in texels.
        phases: (H, W, 2) of the appearance's grid, where there is order to keep.
    """

    spacing: int
    frame: Frame
    bits: int
    appearance: Appearance
    price: NDArray[np.int32]
    similar_bits: int
    similar: NDArray[np.int16]
    phases: Phases | None = None


@dataclass(frozen=True)
class Index:
    """Levels, the finest first."""

    levels: tuple[Level, ...]
    order: Order | None = None
    left_out: float = 0.0


def build_index(exemplar: Exemplar, waves: tuple[Wave, ...] = ()) -> Index:
    """The index of an exemplar."""
    planes = planes_of(exemplar)
    scale = choose_scale(planes)
    features = features_of(planes, scale)
    width, height = exemplar.size
    order = measure_order(features - features.mean(axis=(1, 2), keepdims=True), waves)
    count = level_count(width, height)
    if order is not None:
        count = min(count, _ordered_levels(order))
    grids = list(_grids(features, count))
    levels: list[Level] = []
    start: Similar | None = None
    for level in reversed(range(count)):
        grid, bits, step = grids[level]
        basis = choose_basis(grid, step)
        appearance = project(grid, basis)
        frame = frame_of(level, width, height)
        similar_bits = max(1, level)
        skip = 1 << (similar_bits - bits)
        coarse = np.ascontiguousarray(appearance[::skip, ::skip])
        similar = _similar(coarse, similar_bits, frame, start)
        start = similar
        places = np.stack([similar.columns, similar.rows], axis=-1) << similar_bits
        levels.append(
            Level(
                1 << level,
                frame,
                bits,
                appearance,
                np.zeros(appearance.shape[:2], np.int32),
                similar_bits,
                places.astype(np.int16),
                _phases(order, bits, appearance) if level >= _ORDERED else None,
            )
        )
    return Index(tuple(reversed(levels)), order)


def _phases(order: Order | None, bits: int, appearance: Appearance) -> Phases | None:
    if order is None:
        return None
    rows, columns = (np.arange(n) << bits for n in appearance.shape[:2])
    found = order.phases(columns[None, :], rows[:, None])
    return np.pad(found, ((0, 0), (0, 0), (0, 2 - found.shape[2])))


def level_count(width: int, height: int) -> int:
    """How many levels an exemplar of this size has."""
    count = 1
    while count < MOST_LEVELS and min(width, height) >= (_ROOM + 2 * _MARGIN) << count:
        count += 1
    return count


def _ordered_levels(order: Order) -> int:
    """Levels that pieces of a lattice are drawn finely enough at."""
    return max(1, math.floor(math.log2(order.piece / _FINENESS)) + 1)


def frame_of(level: int, width: int, height: int) -> Frame:
    """Where places of a level may lie."""
    margin = _MARGIN << level
    return Frame(margin, margin, width - 1 - margin, height - 1 - margin)


def _grids(features: Features, count: int) -> Iterator[tuple[Features, int, int]]:
    """Per level: smoothed features, bits of their grid, and the neighbourhood's step on it."""
    yield features, 0, 1
    for level in range(1, count):
        yield smoothed(features), level - 1, 2
        features = halved(features)


def _similar(appearance: Appearance, bits: int, frame: Frame, coarser: Similar | None) -> Similar:
    high, wide = appearance.shape[:2]
    allowed = (
        slice(-(-frame.top >> bits), (frame.bottom >> bits) + 1),
        slice(-(-frame.left >> bits), (frame.right >> bits) + 1),
    )
    start = None
    if coarser is not None and coarser.rows.shape != appearance.shape[:2]:
        rows, columns = (
            np.pad(
                np.repeat(np.repeat(2 * found, 2, 0), 2, 1)[:high, :wide],
                ((0, max(0, high - 2 * found.shape[0])), (0, max(0, wide - 2 * found.shape[1]))),
                mode="edge",
            )
            for found in (coarser.rows, coarser.columns)
        )
        rows[1::2] += 1
        columns[:, 1::2] += 1
        start = (rows, columns)
    elif coarser is not None:
        start = (coarser.rows.copy(), coarser.columns.copy())
    apart = max(_APART, 8 >> bits)
    return find_similar(appearance, apart, allowed, start)
