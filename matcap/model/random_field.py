"""The random field the decoder reads: noise and, for materials with regular order, that order."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from matcap.model.noise import noise_field
from matcap.model.patch import Patch
from matcap.model.regular_order import order_field
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class RandomField:
    """What a decoder reads.

    Attributes:
        noise: (B, noise_channels, H, W).
        waves: per level k, (B, WAVE_CHANNELS + cells, H / 2^k, W / 2^k).
    """

    noise: Tensor
    waves: tuple[Tensor, ...]


def random_field(
    patch: Patch,
    noise_channels: int,
    waves: tuple[Wave, ...],
    *,
    levels: int,
    cells: int = 0,
) -> RandomField:
    """All the decoder reads for one rectangle, as a batch of one.

    Args:
        patch: of level 0; its sides, corner and period are multiples of 2^levels.
        noise_channels: as noise_field's.
        waves: as order_field's.
        levels: of order.
        cells: as order_field's.
    """
    stack = tuple(order_field(patch.at_level(k), waves, cells)[None] for k in range(levels))
    return RandomField(noise_field(patch, noise_channels)[None], stack)
