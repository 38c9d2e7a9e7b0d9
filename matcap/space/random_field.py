"""The decoder's input: white noise, lattice channels and a drawing."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.space.lattice_channels import lattice_field
from matcap.space.noise import noise_field
from matcap.space.patch import Patch
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class RandomField:
    """Inputs of a decoder."""

    noise: Tensor
    """(B, noise_channels, H, W) white noise."""
    waves: tuple[Tensor, ...]
    """Lattice channels of each level k, (B, WAVE_CHANNELS + cells, H / 2^k, W / 2^k)."""
    drawing: tuple[Tensor, ...] = ()
    """The drawing at each level k, (B, DRAWING_CHANNELS, H / 2^k, W / 2^k); empty without one."""

    @property
    def read_up(self) -> tuple[Tensor, ...]:
        """What each level of the way up reads besides features: the drawing, then the lattice."""
        if not self.drawing:
            return self.waves
        return tuple(torch.cat(each, 1) for each in zip(self.drawing, self.waves, strict=True))


def random_field(
    patch: Patch,
    noise_channels: int,
    waves: tuple[Wave, ...],
    *,
    levels: int,
    cells: int = 0,
) -> RandomField:
    """Inputs of a decoder for one rectangle, as a batch of one.

    Args:
        patch: of level 0; its sides, corner and period are multiples of 2^levels.
        levels: that have lattice channels.
    """
    noise = noise_field(patch, noise_channels)[None]
    return RandomField(noise, lattice_levels(patch, waves, cells, levels))


def lattice_levels(
    patch: Patch, waves: tuple[Wave, ...], cells: int, levels: int
) -> tuple[Tensor, ...]:
    """Lattice channels of a patch at the finest `levels` levels; see RandomField.waves."""
    return tuple(lattice_field(patch.at_level(k), waves, cells)[None] for k in range(levels))
