"""Grids of the synthesis levels, the frame that places are limited to, and sizes of patches."""

from __future__ import annotations

from dataclasses import dataclass

from matcap.example.candidates import FeatureMap, halved, smoothed
from matcap.example.lattice import LEAST_PATCH, PhasedLattice

MOST_LEVELS = 5  # so that periods are multiples of 2^4 texels, as the decoder's
COST_BITS = 2  # the grid of placement costs has a step of 2^COST_BITS texels
_MARGIN = 3  # steps between places and the exemplar's border, for their neighbourhoods
_LEAST_STEPS = 8  # least width of the coarsest level's frame, in its steps


@dataclass(frozen=True)
class Frame:
    """Rectangle of the exemplar's texels that places are limited to, ends included."""

    left: int
    top: int
    right: int
    bottom: int

    @staticmethod
    def of(width: int, height: int) -> Frame:
        """All texels of an exemplar of this size."""
        return Frame(0, 0, width - 1, height - 1)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        return self.right - self.left + 1, self.bottom - self.top + 1

    def enlarged(self, bits: int) -> Frame:
        """Its texels of 2^-bits times the side."""
        right, bottom = (self.right + 1 << bits) - 1, (self.bottom + 1 << bits) - 1
        return Frame(self.left << bits, self.top << bits, right, bottom)

    def halved(self, bits: int) -> Frame:
        """The texels of 2^bits times the side that lie within it."""
        left, top = -(-self.left >> bits), -(-self.top >> bits)
        return Frame(left, top, (self.right + 1 >> bits) - 1, (self.bottom + 1 >> bits) - 1)


def frame_of(level: int, part: Frame) -> Frame:
    """The frame of a level's places, for the part of an exemplar that may be shown."""
    margin = _MARGIN << level
    return Frame(part.left + margin, part.top + margin, part.right - margin, part.bottom - margin)


def level_count(width: int, height: int) -> int:
    """Number of levels for an exemplar of this size; 0 if it is too small."""
    count = 0
    while count < MOST_LEVELS and min(width, height) >= (_LEAST_STEPS + 2 * _MARGIN) << count:
        count += 1
    return count


def grid_bits(level: int) -> int:
    """log2 of the step of a level's appearance grid: half its spacing, at least a texel."""
    return max(0, level - 1)


def similar_bits(level: int) -> int:
    """log2 of the step of a level's candidate grid: its spacing, at least two texels."""
    return max(1, level)


def step_of(level: int) -> int:
    """Steps of a level's appearance grid between its places."""
    return 2 if level else 1


def grids_of(features: FeatureMap, count: int) -> list[FeatureMap]:
    """The features on each level's appearance grid, smoothed to the level's spacing."""
    grids = [features]
    for _ in range(1, count):
        grids.append(smoothed(features))
        features = halved(features)
    return grids


# Sizes of the patches that a field's coarsest level is laid from, by its variety.


# Patches of the coarsest level, and corrections; docs/notes/field.md.
_PATCH = 128  # side of the smallest patches, texels
_PART = 2  # least ratio of the exemplar's shorter side to that
_OVERLAP = 3  # steps of the coarsest level by which the largest patch is smaller than the frame


@dataclass(frozen=True)
class PatchSizes:
    """Sizes of patches, in texels of the grid of places."""

    width: int
    height: int
    cells: float
    """Approximate width of patches of a lattice; they are rounded to whole cells."""
    loose: bool
    """Variety 1: squares of a power of two, not fitted to their neighbours."""
    whole: bool
    """Variety 0: all patches are alike, the exemplar repeats."""

    @staticmethod
    def of(frame: Frame, spacing: int, lattice: PhasedLattice | None, variety: float) -> PatchSizes:
        """Patch sizes of a variety.

        Args:
            frame: of the coarsest level's places.
            spacing: of that level, texels.
            lattice: of the exemplar, or None.
            variety: 0 for the whole exemplar, 1 for the smallest patches.
        """
        wide, high = frame.right - frame.left, frame.bottom - frame.top
        small = 1 << (min(_PATCH, min(wide, high) // _PART).bit_length() - 1)
        if variety >= 1.0:
            return PatchSizes(small, small, LEAST_PATCH, loose=True, whole=False)
        largest = [max(small, side - _OVERLAP * spacing) for side in (wide, high)]
        width, height = (
            max(1, round(_across_borders(side, small, variety) / spacing)) * spacing
            for side in largest
        )
        cells = _between(min(largest), LEAST_PATCH, variety)
        if lattice is not None:
            cells = lattice.fitting_cells(cells, largest[0], largest[1])
        return PatchSizes(width, height, cells, loose=False, whole=variety <= 0.0)


def _across_borders(large: int, small: int, variety: float) -> float:
    """Side s, at most `large`, of patches that continue across the exemplar's borders.

    These are seams as well: 1 / s + 1 / large is the inverse of _between.
    """
    return 1.0 / max(variety * (1.0 / small - 1.0 / large), 1.0 / large)


def _between(large: int, small: int, variety: float) -> float:
    """Harmonic interpolation from `large` at 0 to `small` at 1; divisions are exact everywhere."""
    return 1.0 / ((1.0 - variety) / large + variety / small)
