"""A block of a by-example field: what a worker needs, and all it needs; without PyTorch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.folder import NormalStyle
from matcap.model.blocks import RING, Grid
from matcap.model.example.example import Example
from matcap.model.plane import Period, Rectangle, check_period, check_seed

if TYPE_CHECKING:
    from torch import Tensor

# Wider than the decoder's: places around a block are most of what a small one costs.
_GRID = Grid(1024, 256)


@dataclass(frozen=True)
class ExampleSource:
    """The by-example field of one exemplar and seed; picklable.

    Attributes:
        example: the exemplar, indexed.
        seed: which realisation.
        period: what repeats, in multiples of the example's alignment.
        texel_size: in plane units.
        grid: the blocks that the plane is cut into.
    """

    example: Example
    seed: int
    period: Period | None
    texel_size: float
    grid: Grid = _GRID

    @property
    def device_type(self) -> str:
        """Where it is computed: places are integers, and the same everywhere."""
        return "cpu"

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (OUTPUTS, height + 2 RING, width + 2 RING) of a block and its ring."""
        import torch

        return torch.from_numpy(self._stacked(block))

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9, height, width) of a block: the six maps and the normal."""
        maps = self._stacked(block)
        height, size = maps[5], np.float32(2.0 * self.texel_size)
        across = (height[RING:-RING, 2 * RING :] - height[RING:-RING, : -2 * RING]) / size
        up = (height[: -2 * RING, RING:-RING] - height[2 * RING :, RING:-RING]) / size
        upright = np.float32(1.0) / np.sqrt(np.float32(1.0) + across * across + up * up)
        found = np.empty((9, block.height, block.width), np.float32)
        found[:6] = maps[:, RING:-RING, RING:-RING]
        np.multiply(across, -upright, out=found[6])
        np.multiply(up, upright if normal == "dx" else -upright, out=found[7])
        found[8] = upright
        return found

    def _stacked(self, block: Rectangle) -> NDArray[np.float32]:
        return self.example.maps(self.seed, block.grown(RING), self.period)


def example_source(example: Example, seed: int, period: Period | None = None) -> ExampleSource:
    """The source of an exemplar's field.

    Raises:
        UsageError: a seed or period out of range.
    """
    check_seed(seed)
    check_period(period, example.alignment)
    return ExampleSource(example, seed, period, example.exemplar.texel_size)
