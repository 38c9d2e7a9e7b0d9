"""Sizes of the patches that a field's coarsest level is laid from, by its variety."""

from __future__ import annotations

from dataclasses import dataclass

from matcap.example.grids import Frame
from matcap.example.lattice import LEAST_PATCH, PhasedLattice

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
