"""A source whose blocks are those of another source with adjustments applied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.adjust import Adjustments, adjusted_planes
from matcap.brdf.stated import NormalStyle
from matcap.field.blocks import Grid
from matcap.field.plane import Period, Rectangle

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.field.source import Source


@dataclass(frozen=True)
class AdjustedSource:
    """A source with adjustments; picklable if the inner source is."""

    source: Source
    adjustments: Adjustments

    @property
    def texel_size(self) -> float:
        """Side of a texel, plane units."""
        return self.source.texel_size

    @property
    def grid(self) -> Grid:
        """The grid of blocks."""
        return self.source.grid

    @property
    def period(self) -> Period | None:
        """Period along (x, y), texels; None if the field never repeats."""
        return self.source.period

    @property
    def specular_channels(self) -> int:
        """Channels of F0: 1, or 3 where it has a colour."""
        return self.source.specular_channels

    @property
    def device_type(self) -> str:
        """Device that computes it: "cpu" or "cuda"."""
        return self.source.device_type

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps of a block and its ring."""
        import torch

        maps = self.source.maps(block)
        return torch.from_numpy(adjusted_planes(maps.cpu().numpy(), self.adjustments))

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) maps and normal of a block."""
        return adjusted_planes(self.source.planes(block, normal), self.adjustments)


def adjusted_source(source: Source, adjustments: Adjustments) -> Source:
    """The source with adjustments; the source itself without any."""
    return AdjustedSource(source, adjustments) if adjustments.changes else source
