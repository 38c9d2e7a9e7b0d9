"""Source of blocks from periodic maps held in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.stated import NormalStyle
from matcap.example.exemplar import SPECULAR, Floats
from matcap.example.normals import with_normals
from matcap.field.blocks import RING, Grid
from matcap.field.plane import Period, Rectangle

if TYPE_CHECKING:
    from torch import Tensor

BLOCKS = Grid(1024, 256)  # wider than a decoder's: for small blocks most time goes into the margin


@dataclass(frozen=True)
class RepeatedSource:
    """A seamless tile, repeated; picklable."""

    stacked: Floats
    """(6 or 8, h, w) maps of the tile."""
    texel_size: float
    """Side of a texel in plane units."""
    grid: Grid = BLOCKS

    @property
    def period(self) -> Period:
        """The tile's sides, in texels."""
        return self.stacked.shape[2], self.stacked.shape[1]

    @property
    def specular_channels(self) -> int:
        """Channels of F0: 1, or 3 where it has a colour."""
        return len(self.stacked[SPECULAR])

    @property
    def device_type(self) -> str:
        """Device of the maps."""
        return "cpu"

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (6 or 8, height + 2 RING, width + 2 RING) of a block and its ring."""
        import torch

        return torch.from_numpy(self._around(block))

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) maps and normal of a block."""
        return with_normals(self._around(block), self.texel_size, normal)

    def _around(self, block: Rectangle) -> Floats:
        area = block.grown(RING)
        rows = np.arange(area.y, area.y + area.height) % self.stacked.shape[1]
        columns = np.arange(area.x, area.x + area.width) % self.stacked.shape[2]
        return self.stacked[:, rows[:, None], columns[None, :]]
