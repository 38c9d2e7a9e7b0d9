"""Tables that the synthesis reads, by level, computed from an exemplar and its index.

A level is a grid of the field with a spacing of 2^level texels. Its neighbourhoods are compared by
the appearance of the exemplar smoothed to that spacing, sampled at half of it.
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
from matcap.example.lattice import PhasedLattice, Phases
from matcap.example.patch_sizes import PatchSizes

# Tables of the synthesis; docs/notes/field.md.
_ORDERED = 1  # first level at which phase errors have a cost
# Placement cost is penalty^2 * 2^cost_bits: 1.3e8 at the penalty 255, more than any seam; 4e5 at
# 14, as much as a common seam.
PENALTY_BITS = 11
_SPARED = 16  # at most 1 / 16 of the frame is left out at either end, so that opposite borders fit


@dataclass(frozen=True)
class Level:
    """Tables of one level."""

    spacing: int
    """Texels between places of the field."""
    frame: Frame
    """Limits of places."""
    bits: int
    """log2 of the appearance grid's step in texels."""
    appearance: Appearance
    """(H, W, DIMENSIONS) appearance vectors of the exemplar's places."""
    similar_bits: int
    """log2 of the candidate grid's step in texels."""
    similar: NDArray[np.int16]
    """(H, W, 2) k-coherence candidates, x, y in texels."""
    placement_cost: NDArray[np.int32]
    """(H, W) of squares of 2^COST_BITS texels, added to the mismatch."""
    phases: Phases | None
    """(H, W, 2) on the appearance grid; None where the level keeps to no lattice."""


@dataclass(frozen=True)
class Lookup:
    """Tables of all levels."""

    levels: tuple[Level, ...]
    """Levels of the pyramid, finest first."""
    lattice: PhasedLattice | None
    sizes: PatchSizes
    """Sizes of the coarsest level's patches."""
    joined: Frame
    """The part of its frame of which opposite borders adjoin."""


def prepare(exemplar: Exemplar, index: Index, variety: float = 1.0) -> Lookup:
    """Compute the tables of an exemplar.

    Args:
        exemplar: on its grid of places.
        index: of the exemplar.
        variety: in [0, 1].
    """
    width, height = exemplar.size
    features = features_of(planes_of(exemplar), index.scale)
    grids = grids_of(features, len(index.bases))
    with ThreadPoolExecutor() as pool:
        appearances = list(pool.map(project, grids, index.bases))
    placement_cost = np.square(index.penalty, dtype=np.int32) << PENALTY_BITS
    lattice = kept_lattice(index, variety)
    levels = tuple(
        Level(
            spacing=1 << level,
            frame=frame_of(level, width, height),
            bits=grid_bits(level),
            appearance=appearance,
            similar_bits=similar_bits(level),
            similar=similar,
            placement_cost=placement_cost,
            phases=_phases(lattice, level, appearance),
        )
        for level, (appearance, similar) in enumerate(zip(appearances, index.similar, strict=True))
    )
    sizes = PatchSizes.of(levels[-1].frame, levels[-1].spacing, lattice, variety)
    return Lookup(levels, lattice, sizes, _joined_frame(levels[-1]))


def kept_lattice(index: Index, variety: float) -> PhasedLattice | None:
    """The lattice that patches are aligned with; None at variety 0, where the exemplar repeats."""
    return index.lattice if variety > 0.0 else None


def _joined_frame(level: Level) -> Frame:
    """The part of a level's frame of which opposite borders differ least in appearance."""
    frame, bits = level.frame, level.bits
    rows = slice(frame.top >> bits, (frame.bottom >> bits) + 1)
    inside = level.appearance[rows, frame.left >> bits : (frame.right >> bits) + 1].astype(np.int64)
    top, bottom = _least_step(inside)
    left, right = _least_step(inside[top:bottom].swapaxes(0, 1))
    return Frame(
        frame.left + (left << bits),
        frame.top + (top << bits),
        frame.left + (right << bits) - 1,
        frame.top + (bottom << bits) - 1,
    )


def _least_step(rows: NDArray[np.int64]) -> tuple[int, int]:
    """First row, and the one after the last, of which the second continues the last best."""
    spared = len(rows) // _SPARED
    first, after = rows[: spared + 1, None], rows[None, len(rows) - 1 - spared :]
    differences = np.square(first - after).sum(axis=(2, 3))
    begin, end = np.unravel_index(int(np.argmin(differences)), differences.shape)
    return int(begin), len(rows) - 1 - spared + int(end)


def _phases(lattice: PhasedLattice | None, level: int, appearance: Appearance) -> Phases | None:
    if lattice is None or level < _ORDERED:
        return None
    rows, columns = (np.arange(n) << grid_bits(level) for n in appearance.shape[:2])
    return two_phases(lattice.phases(columns[None, :], rows[:, None]))


def two_phases(phases: Phases) -> Phases:
    """(..., 2) phases; with one wave the second is 0."""
    return np.pad(phases, ((0, 0), (0, 0), (0, 2 - phases.shape[-1])))
