"""Sliced Wasserstein distance of patches of two textures; no weights, never tuned to.

The sliced Wasserstein distance [rabin2011] of patches [elnekave2022]: patches of 3, 7 and 15 texels
a side, at three scales, are projected on random directions, and the sorted projections of the two
pictures are compared. It depends on the distribution of patches, not on their positions: sensitive
to colours, edges and grain, hardly to structures longer than a patch, such as cracks.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.lab.measures.style import Group, StyleStatistics

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
