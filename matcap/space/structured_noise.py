"""Structure in the noise: irregular cells and streaks, pure functions of (seed, x, y).

White noise through a network of finite reach makes grains and clouds, hardly ever cells: a closed
line around every place, or one long fibre, needs places far apart to agree. Cellular noise (Worley
1996, "A cellular texture basis function") has that agreement: every cell of a square lattice holds
one random point, and a texel knows the nearest point and how far the second nearest is. Beside
white noise it gives the network

- *cells* of 8 to 64 texels: the distance to their border, and a number of each cell's own;
- *streaks*, cells stretched along x or along y: a number of each streak's own.

All of zero mean and about unit variance; how much a material shows of each its code says.
Coordinates are integers, so nothing drifts or loses digits far away; a period is kept exactly by
fitting a whole number of cells into it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.space.noise import noise_at, wrap64
from matcap.space.patch import Patch

_CELLS = (8, 16, 32, 64)  # texels between points
_STREAKS = ((40, 3), (3, 40), (120, 8), (8, 120))  # texels between points, along x and y
GRAIN_CHANNELS = 2 * len(_CELLS) + len(_STREAKS)

_SEED = 0xD6E8FEB86659FD93  # sets their seeds apart from the other noises'
_JITTER = 0.42 / math.sqrt(
    3.0
)  # lattice steps to a unit of noise: points move up to 0.42 either way
# Of the second nearest point's distance less the nearest one's, in lattice steps; measured.
_BORDER_MEAN, _BORDER_DEVIATION = 0.282, 0.203


def grain_field(patch: Patch) -> Tensor:
    """(GRAIN_CHANNELS, height, width) float32: cells' borders and numbers, then streaks' numbers.

    Args:
        patch: of level 0.
    """
    lattices = [(size, size) for size in _CELLS] + list(_STREAKS)
    channels = []
    for index, spacing in enumerate(lattices):
        border, number = _cellular(patch, spacing, wrap64(patch.seed ^ _SEED * (index + 1)))
        channels += [border, number] if index < len(_CELLS) else [number]
    return torch.stack(channels).to(patch.device)


@dataclass(frozen=True)
class _Line:
    """Where the texels of one row or column lie among the lattice's cells."""

    cells: Tensor
    """(N + 2,) int64 the N cells that they meet, one after another, and one more at either end."""
    place: Tensor
    """(texels,) which of the N cells a texel lies in."""
    within: Tensor
    """(texels,) float32 how far it has come through it, 0 to 1."""


def _line(texels: list[int], spacing: int, period: int | None) -> _Line:
    count = 0 if period is None else max(1, round(period / spacing))
    # A texel's centre in cells is (2 texel + 1) / step: whole numbers, exact however far away.
    times, step = (1, 2 * spacing) if period is None else (count, 2 * period)
    reached = [(2 * texel + 1) * times for texel in texels]
    cells = [value // step for value in reached]
    met, place = [cells[0]], []
    for cell in cells:
        if cell != met[-1]:
            met.append(cell)
        place.append(len(met) - 1)
    around = [met[0] - 1, *met, met[-1] + 1]
    return _Line(
        torch.tensor([cell % count for cell in around] if count else around),
        torch.tensor(place),
        torch.tensor([value % step / step for value in reached]),
    )


def _cellular(patch: Patch, spacing: tuple[int, int], seed: int) -> tuple[Tensor, Tensor]:
    """(height, width) each: nearness to a border between cells, and a number of each cell's own."""
    columns, rows = (
        _line(line.tolist(), size, period)
        for line, size, period in zip(patch.places("cpu"), spacing, patch.along, strict=True)
    )
    points = noise_at(seed, 3, columns.cells[None, :], rows.cells[:, None])
    points = torch.stack([points[0] * _JITTER + 0.5, points[1] * _JITTER + 0.5, points[2]])
    first = torch.full(patch.shape, 9.0)
    second, number = first.clone(), torch.zeros(patch.shape)
    for down in range(3):
        row_points = points[:, rows.place + down]
        for across in range(3):
            x, y, own = row_points[:, :, columns.place + across]
            x += (across - 1.0 - columns.within)[None, :]
            y += (down - 1.0 - rows.within)[:, None]
            squared = x.mul_(x).add_(y.mul_(y))
            number = torch.where(squared < first, own, number)
            torch.minimum(second, torch.maximum(first, squared), out=second)
            torch.minimum(first, squared, out=first)
    border = (second.sqrt() - first.sqrt() - _BORDER_MEAN) / _BORDER_DEVIATION
    return border, number
