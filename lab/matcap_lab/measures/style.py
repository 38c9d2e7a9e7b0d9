"""Style distances of textures, by statistics that no capture optimises.

The distance is the mean over groups g of statistics of the relative difference

    |a_g - b_g|_1 / ((|a_g|_1 + |b_g|_1) / 2),

at most 2, so that no group dominates.

1. *Random filters* of other sizes (7, 11, 13) and another seed than capture's, on a pyramid of four
   levels, rectified: groups are Gram matrices and means by level. The raw colours are among the
   means.
2. *Patches*: sliced Wasserstein distance [rabin2011] of patches [elnekave2022] of 3, 7 and 15
   texels a side at three scales, projected on random directions and sorted. Sensitive to colours,
   edges and grain, hardly to structures longer than a patch.

All are 0 for equal pictures, and symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.statistics.filterbank import FilterBank, FilterBankConfig, pyramid
from matcap.statistics.gram import gram


@dataclass(frozen=True)
class Group:
    """Statistics (B, N) that enter the distance as one term; their threshold of visibility t_g."""

    values: Tensor
    unseen: float


StyleStatistics = dict[str, Group]


class Style(Protocol):
    """Texture statistics: sRGB pictures (B, 3, H, W) in [0, 1] to groups."""

    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Style statistics of pictures."""
        ...


def difference(first: StyleStatistics, second: StyleStatistics) -> Tensor:
    """(B,) distance between pictures of the same lights, the mean over groups."""
    return torch.stack([_relative(first[name], second[name]) for name in first]).mean(0)


class RandomFilters:
    """Gram matrices and means of random filters other than capture's."""

    def __init__(self) -> None:
        self._bank = FilterBank(FilterBankConfig(sizes=(7, 11, 13), filters=20, levels=4, seed=777))

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe (B, 3, H, W)."""
        groups = {}
        for level, image in enumerate(pyramid(pictures, self._bank.config.levels)):
            features = self._bank.features(image.contiguous(memory_format=torch.channels_last))
            means = torch.cat([features.mean((2, 3)), image.mean((2, 3))], dim=1)
            groups[f"gram {level}"] = Group(gram(features)[:, :-1, :-1].flatten(1), 0.0)
            groups[f"means {level}"] = Group(means, 0.0)
        return groups

    @torch.no_grad()
    def features(self, pictures: Tensor) -> list[Tensor]:
        """Rectified responses (B, filters, h, w) at every pyramid level of (B, 3, H, W)."""
        return self._bank.maps(pictures, pyramid(pictures, self._bank.config.levels))


def _relative(first: Group, second: Group) -> Tensor:
    """(B,) relative L1 difference of a group."""
    difference = (first.values - second.values).abs().mean(1)
    size = (first.values.abs().mean(1) + second.values.abs().mean(1)) / 2.0
    return difference / (size + first.unseen).clamp_min(1e-12)


SIDES = (3, 7, 15)  # texels of a patch
SCALES = 3  # each of half the size of the one before
_DIRECTIONS = 64  # a side and scale
_QUANTILES = 128  # along each
_SEED = 4242
_UNSEEN = 0.005  # about one 8-bit code value


class Patches:
    """Sorted projections of patches."""

    def __init__(self) -> None:
        """Draw directions, all of unit length."""
        generator = torch.Generator().manual_seed(_SEED)
        self._directions = []
        for side in SIDES:
            drawn = torch.randn(_DIRECTIONS, 3, side, side, generator=generator)
            self._directions.append(drawn / drawn.flatten(1).norm(dim=1)[:, None, None, None])

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe sRGB-encoded pictures (B, 3, H, W) in [0, 1].

        Raises:
            ValueError: pictures whose coarsest scale holds no patch.
        """
        if min(pictures.shape[-2:]) < max(SIDES) * 2 ** (SCALES - 1):
            raise ValueError(f"pictures of {tuple(pictures.shape)} are too small to be compared")
        shares = (torch.arange(_QUANTILES) + 0.5) / _QUANTILES
        groups = {}
        for scale in range(SCALES):
            picture = F.avg_pool2d(pictures, 2**scale)
            for side, directions in zip(SIDES, self._directions, strict=True):
                along = F.conv2d(picture, directions).flatten(2).sort(dim=2).values
                places = (shares * along.shape[2]).long()
                groups[f"scale {scale}, side {side}"] = Group(
                    along[..., places].flatten(1), _UNSEEN
                )
        return groups
