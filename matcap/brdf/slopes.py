"""Mean squared slopes of maps: as normals show them, between texels, and octave by octave."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet

_OCTAVES = 5  # the finest one texel's


def slope_energies(maps: MapSet) -> list[Tensor]:
    """(B,) mean squared slopes of maps (B, C, H, W): as normals show them, then by octave."""
    height = maps.height / maps.texel_size
    energies = [shown_energy(maps)]
    for octave in range(_OCTAVES):
        energies.append(energy_between(height) / 4.0**octave)
        height = F.avg_pool2d(height, 2)
    return energies


def relief_difference(maps: MapSet, others: MapSet, flat: float) -> Tensor:
    """(B,) mean over octaves of the absolute difference of log mean squared slope.

    Args:
        maps: (B, C, H, W).
        others: the maps that they are compared with.
        flat: root-mean-square slope that is added to both.
    """
    both = zip(slope_energies(maps), slope_energies(others), strict=True)
    ratios = [(ours + flat**2) / (theirs + flat**2) for ours, theirs in both]
    return torch.stack([ratio.log().abs() for ratio in ratios]).mean(0)


def shown_energy(maps: MapSet) -> Tensor:
    """(B,) mean squared slope of the normals."""
    normal = maps.normal
    return (normal[..., :2, :, :] / normal[..., 2:, :, :]).square().sum(-3).mean((-2, -1))


def energy_between(height: Tensor) -> Tensor:
    """(B,) mean squared difference between neighbouring texels of heights (B, 1, H, W)."""
    across, down = height.diff(dim=-1), height.diff(dim=-2)
    return across.square().mean((-3, -2, -1)) + down.square().mean((-3, -2, -1))
