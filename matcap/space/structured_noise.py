"""Structured noise: cellular noise [worley1996] and streaks, pure functions of (seed, x, y).

A network on white noise makes grains and clouds, but hardly closed cell borders or long fibres,
which need correlation beyond its receptive field. In cellular noise each cell of a grid holds one
random point, jittered within it. With distances d1 to a texel's nearest point and d2 to the second
nearest, in grid steps, the channels are

- *cells*, for grids of 8 to 64 texels: d2 - d1, which is small at borders between cells, and a
  random number of the nearest point;
- *streaks*, for grids stretched along x or y: a random number of the nearest point.

All have zero mean and about unit variance. Grid positions are computed in integers, exact at any
distance; with a period a whole number of grid cells fits into it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.space.noise import noise_at, wrap64
from matcap.space.patch import Patch

_CELLS = (8, 16, 32, 64)  # grid steps in texels
_STREAKS = ((40, 3), (3, 40), (120, 8), (8, 120))  # grid steps in texels along x and y
STRUCTURED_CHANNELS = 2 * len(_CELLS) + len(_STREAKS)

_SEED = 0xD6E8FEB86659FD93  # makes seeds independent of those of the white noise
_JITTER = 0.42 / math.sqrt(3.0)  # grid steps per unit of noise: offsets are within +-0.42
_BORDER_MEAN, _BORDER_DEVIATION = 0.282, 0.203  # of d2 - d1, in grid steps; measured


def structured_field(patch: Patch) -> Tensor:
    """(STRUCTURED_CHANNELS, height, width) float32: border and number by grid, then streaks.

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
    """Grid cells of the texels along one axis."""

    cells: Tensor
    """(N + 2,) int64 numbers of the N cells that the texels lie in, and of one more at each end."""
    place: Tensor
    """(texels,) index of the texel's cell among the N."""
    within: Tensor
    """(texels,) float32 position within its cell, in [0, 1)."""


def _line(texels: list[int], spacing: int, period: int | None) -> _Line:
    count = 0 if period is None else max(1, round(period / spacing))
    # A texel's centre is at (2 texel + 1) times / step cells, computed in exact integers.
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
    """(height, width) each: normalised d2 - d1, and the random number of the nearest point."""
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
