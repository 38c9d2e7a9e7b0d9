"""The random field the decoder reads: noise and, for materials with regular order, that order."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.model.noise import Period, noise_field
from matcap.model.order import order_field
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
    seed: int,
    noise_channels: int,
    waves: tuple[Wave, ...],
    x: int,
    y: int,
    width: int,
    height: int,
    *,
    levels: int,
    cells: int = 0,
    period: Period | None = None,
    device: torch.device | str = "cpu",
) -> RandomField:
    """All the decoder reads for one rectangle, as a batch of one.

    x, y, width, height and the period are multiples of 2^levels; the rest as noise_field and
    order_field.
    """
    noise = noise_field(seed, noise_channels, x, y, width, height, period=period, device=device)
    stack = tuple(
        order_field(
            seed, waves, cells, x >> k, y >> k, width >> k, height >> k,
            level=k, period=period, device=device,
        )[None]
        for k in range(levels)
    )  # fmt: skip
    return RandomField(noise[None], stack)
