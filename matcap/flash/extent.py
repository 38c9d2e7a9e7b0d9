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
    """A rectangle of the plane, covered by square texels."""

    middle: tuple[float, float] = (0.0, 0.0)
    """(x, y) of its centre, plane units."""
    half: float = 1.0
    """Half of its width, plane units."""

    def texel(self, across: int) -> float:
        """Side of a texel, plane units, of a grid of `across` texels."""
        return 2.0 * self.half / across

    def unit(self, across: int) -> float:
        """Texels along the first photograph's long side, of a grid of `across` texels."""
        return across / self.half

    def across(self, unit: float) -> int:
        """The inverse of unit(), rounded."""
        return round(unit * self.half)

    def placed(self, points: Tensor) -> Tensor:
        """Map plane points (3, ...) of a grid over OWN to this rectangle."""
        middle = torch.tensor([*self.middle, 0.0], dtype=points.dtype)
        return self.half * points + middle.reshape(3, *(1,) * (points.ndim - 1))


OWN = Extent()


@dataclass(frozen=True)
class Margins:
    """Margins of a mosaic around the first photograph's grid, texels."""

    left: int = 0
    right: int = 0
    top: int = 0
    bottom: int = 0

    @property
    def any(self) -> bool:
        """Whether any margin is not 0."""
        return max(self.left, self.right, self.top, self.bottom) > 0

    def around(self, size: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the mosaic around a grid of `size` = (width, height)."""
        return size[0] + self.left + self.right, size[1] + self.top + self.bottom

    def extent(self, across: int) -> Extent:
        """Extent of the mosaic, the first photograph's grid being `across` texels wide."""
        middle = (self.right - self.left) / across, (self.top - self.bottom) / across
        return Extent(middle, (across + self.left + self.right) / across)

    def turned(self) -> Margins:
        """Margins of the mosaic rotated 90 degrees clockwise."""
        return Margins(self.bottom, self.top, self.left, self.right)

    def inside_of(self, shape: tuple[int, int]) -> tuple[int, int]:
        """(rows, columns) of the first photograph's grid, from those of the mosaic."""
        return shape[0] - self.top - self.bottom, shape[1] - self.left - self.right

    def padded(self, planes: Tensor, value: float = 0.0) -> Tensor:
        """Pad (..., h, w) on the first photograph's grid to the mosaic's (..., H, W)."""
        return F.pad(planes, (self.left, self.right, self.top, self.bottom), value=value)

    def inside(self, size: tuple[int, int]) -> tuple[slice, slice]:
        """Slices of rows and columns of the first photograph's grid (width, height)."""
        return (
            slice(self.top, self.top + size[1]),
            slice(self.left, self.left + size[0]),
        )

    def own(self, size: tuple[int, int]) -> Tensor:
        """(H, W) bool on the mosaic: the first photograph's grid of (width, height) texels."""
        return self.padded(torch.ones(size[::-1], dtype=torch.bool))
