"""Extent of the exemplar on the plane: the first photograph's rectangle, or larger.

Plane units are the first photograph's whatever the rectangle: half of its long side.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor


@dataclass(frozen=True)
class Extent:
    """A rectangle of the plane that square texels lie on."""

    middle: tuple[float, float] = (0.0, 0.0)
    """(x, y) of it, plane units."""
    half: float = 1.0
    """Of its width."""

    def texel(self, across: int) -> float:
        """Side of a texel, plane units, of so many across."""
        return 2.0 * self.half / across

    def unit(self, across: int) -> float:
        """Texels of the first photograph's long side, of so many across."""
        return across / self.half

    def across(self, unit: float) -> int:
        """The inverse of unit(), whole."""
        return round(unit * self.half)

    def within(self, point: tuple[float, float]) -> tuple[float, float]:
        """A point of the plane in halves of this rectangle's width from its middle."""
        return (point[0] - self.middle[0]) / self.half, (point[1] - self.middle[1]) / self.half

    def placed(self, points: Tensor) -> Tensor:
        """(3, ...) plane points of a grid as if this were OWN, where they are."""
        middle = torch.tensor([*self.middle, 0.0], dtype=points.dtype)
        return self.half * points + middle.reshape(3, *(1,) * (points.ndim - 1))


OWN = Extent()


@dataclass(frozen=True)
class Margins:
    """Texels by which a piece reaches beyond the first photograph's own grid."""

    left: int = 0
    right: int = 0
    top: int = 0
    bottom: int = 0

    @property
    def any(self) -> bool:
        """Whether it does."""
        return max(self.left, self.right, self.top, self.bottom) > 0

    def around(self, size: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the piece, of the first photograph's own grid."""
        return size[0] + self.left + self.right, size[1] + self.top + self.bottom

    def extent(self, across: int) -> Extent:
        """Of the piece, where the first photograph's own grid is so many texels across."""
        middle = (self.right - self.left) / across, (self.top - self.bottom) / across
        return Extent(middle, (across + self.left + self.right) / across)

    def turned(self) -> Margins:
        """Of the piece turned a quarter clockwise."""
        return Margins(self.bottom, self.top, self.left, self.right)

    def inside_of(self, shape: tuple[int, int]) -> tuple[int, int]:
        """(rows, columns) of the first photograph's own grid, of the piece's."""
        return shape[0] - self.top - self.bottom, shape[1] - self.left - self.right

    def padded(self, planes: Tensor, value: float = 0.0) -> Tensor:
        """(..., H, W) of the piece, of the first photograph's own grid, the rest one value."""
        return F.pad(planes, (self.left, self.right, self.top, self.bottom), value=value)

    def inside(self, size: tuple[int, int]) -> tuple[slice, slice]:
        """Rows and columns of the first photograph's own grid (width, height) in the piece's."""
        return (
            slice(self.top, self.top + size[1]),
            slice(self.left, self.left + size[0]),
        )

    def own(self, size: tuple[int, int]) -> Tensor:
        """(H, W) bool of the piece: what is the first photograph's own grid (width, height)."""
        return self.padded(torch.ones(size[::-1], dtype=torch.bool))


NO_MARGINS = Margins()
