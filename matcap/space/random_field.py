"""The random field the decoder reads: noise and, for materials with regular order, that order.

Noise is white, and also structured (structured_noise.py) where the decoder reads that, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.space.noise import noise_field
from matcap.space.patch import Patch
from matcap.space.regular_order import order_field
from matcap.space.structured_noise import grain_field
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class RandomField:
    """What a decoder reads."""

    noise: Tensor
    """(B, noise_channels + grains, H, W): white, then structured."""
    waves: tuple[Tensor, ...]
    """Per level k, (B, WAVE_CHANNELS + cells, H / 2^k, W / 2^k)."""


def random_field(
    patch: Patch,
    noise_channels: int,
    waves: tuple[Wave, ...],
    *,
    levels: int,
    cells: int = 0,
    grains: int = 0,
) -> RandomField:
    """All the decoder reads for one rectangle, as a batch of one.

    Args:
        patch: of level 0; its sides, corner and period are multiples of 2^levels.
        noise_channels: as noise_field's.
        waves: as order_field's.
        levels: of order.
        cells: as order_field's.
        grains: as noise_of's.
    """
    stack = tuple(order_field(patch.at_level(k), waves, cells)[None] for k in range(levels))
    return RandomField(noise_of(patch, noise_channels, grains)[None], stack)


def noise_of(patch: Patch, white: int, grains: int) -> Tensor:
    """(white + grains, height, width) noise of a patch of level 0.

    Args:
        patch: which rectangle.
        white: channels of white noise.
        grains: channels of structured noise, the first ones of grain_field.
    """
    noise = noise_field(patch, white)
    if not grains:
        return noise
    joined = torch.cat([noise, grain_field(patch)[:grains]])
    return joined.permute(1, 2, 0).contiguous().permute(2, 0, 1)  # in memory channels come last
