"""A rectangle of one realisation of the random field, at a mip level."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.field.plane import Period, Rectangle


@dataclass(frozen=True)
class Patch:
    """Texels at which noise and lattice channels are computed."""

    seed: int
    """Seed of the realisation, in [-2^63, 2^63)."""
    area: Rectangle
    """Rectangle in texels of the level."""
    level: int = 0
    """Texels are 2^level times as large."""
    period: Period | None = None
    """Period in texels of level 0; None is endless."""
    device: torch.device | str = "cpu"
    """Device to compute on; values are the same on every device."""

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.area.height, self.area.width

    @property
    def along(self) -> Period:
        """The period along x and along y in texels of level 0, None where endless."""
        return (None, None) if self.period is None else self.period

    def at_level(self, level: int) -> Patch:
        """This patch of level 0 at a coarser level; its coordinates are multiples of 2^level."""
        x, y = self.area.x >> level, self.area.y >> level
        width, height = self.area.width >> level, self.area.height >> level
        return replace(self, area=Rectangle(x, y, width, height), level=level)

    def places(self, device: torch.device | str | None = None) -> tuple[Tensor, Tensor]:
        """Columns (width,) and rows (height,), int64, modulo the period."""
        area = self.area
        where = self.device if device is None else device
        columns = torch.arange(area.x, area.x + area.width, dtype=torch.int64, device=where)
        rows = torch.arange(area.y, area.y + area.height, dtype=torch.int64, device=where)
        columns, rows = (
            line if length is None else line.remainder(length >> self.level)
            for line, length in zip((columns, rows), self.along, strict=True)
        )
        return columns, rows
