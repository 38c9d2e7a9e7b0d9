"""Patch sizes: how large the patches are that a field's coarsest level is laid from."""

from __future__ import annotations

from dataclasses import dataclass

from matcap.example.grids import Frame
from matcap.example.order import Order
from matcap.example.tuned import ORDER, PLACEMENT


@dataclass(frozen=True)
class PieceSizes:
    """Into what pieces."""

    width: int
    height: int
    """Of a piece, in texels of the grid of places."""
    cells: float
    """Texels along cells of a lattice that are laid together, at most."""
    loose: bool
    """As at full variety: squares of a power of two, each for itself."""

    @staticmethod
    def of(frame: Frame, spacing: int, order: Order | None, variety: float) -> PieceSizes:
        """Pieces of a variety.

        Args:
            frame: where places of the coarsest level may lie.
            spacing: of that level.
            order: that pieces keep to.
            variety: 0 for the whole exemplar repeated, 1 for the smallest pieces.
        """
        wide, high = frame.right - frame.left, frame.bottom - frame.top
        small = 1 << (min(PLACEMENT.piece, min(wide, high) // PLACEMENT.part).bit_length() - 1)
        if variety >= 1.0:
            return PieceSizes(small, small, ORDER.piece, loose=True)
        largest = [max(small, side - PLACEMENT.overlap * spacing) for side in (wide, high)]
        width, height = (
            max(1, round(_between(side, small, variety) / spacing)) * spacing for side in largest
        )
        cells = _between(min(largest), ORDER.piece, variety)
        if order is not None:
            cells = order.fitting(cells, largest[0], largest[1])
        return PieceSizes(width, height, cells, loose=False)


def _between(large: int, small: int, variety: float) -> float:
    """A size; by divisions alone, which are the same on every machine."""
    return 1.0 / ((1.0 - variety) / large + variety / small)
