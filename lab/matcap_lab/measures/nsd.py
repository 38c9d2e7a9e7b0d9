"""Normalised style distance (NSD): style distance to the truth, over that of two true samples.

The style distance by SqueezeNet, to which no setting is tuned, compares Gram matrices of its first
convolution and its fire modules, at two scales. The distance of two Gram matrices is relative,

    |A - B|_1 / ((|A|_1 + |B|_1) / 2),

and the measure is the mean over layers and scales: 0 for equal pictures, at most 2, and symmetric.
It responds to open cells and broken threads, which linear filter banks hardly do.

NSD divides it by the mean distance between true samples of the same material: 1 is
indistinguishable from another sample. Larger pictures discriminate better: true samples of leather
differ by 0.12 over the whole picture, by 0.19 over a quarter of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.statistics.gram import gram
from matcap_lab.measures.networks import SqueezeNet
from matcap_lab.measures.style import Group, Style, StyleStatistics, difference

SCALES = 2  # the second of half the size
_SMALLEST = 64  # texels a side at the coarser scale


class SqueezeNetStyle:
    """Statistics of SqueezeNet's responses, a Style."""

    def __init__(self, network: SqueezeNet | None = None) -> None:
        """Take a network; by default SqueezeNet with the packaged weights."""
        self._network = network or SqueezeNet.load()

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe sRGB-encoded pictures (B, 3, H, W) in [0, 1], at least 128 texels a side.

        Raises:
            ValueError: smaller pictures.
        """
        if min(pictures.shape[-2:]) < _SMALLEST * 2 ** (SCALES - 1):
            raise ValueError(f"pictures of {tuple(pictures.shape)} are too small to be compared")
        groups = {}
        for scale in range(SCALES):
            responses = self._network(F.avg_pool2d(pictures, 2**scale))
            for layer, features in enumerate(responses):
                matrix = gram(features)[:, :-1, :-1]
                groups[f"scale {scale}, layer {layer}"] = Group(matrix.flatten(1), 0.0)
        return groups


def style_distance(style: Style, first: Tensor, second: Tensor) -> float:
    """Mean style distance of sRGB-encoded pictures (B, 3, H, W) in [0, 1], of the same lights."""
    return float(difference(style(first), style(second)).mean())


class StyleRatio:
    """Style distance to true samples of one material over that between them, by any one style.

    By SqueezeNet it is NSD.
    """

    def __init__(self, style: Style, truths: Sequence[Tensor]) -> None:
        """Describe true samples by a style.

        There are two or more of the material, none of them the photographed one, each (L, 3, H, W),
        relit from L directions.
        """
        self._style = style
        self._truths = [style(truth) for truth in truths]
        pairs = list(itertools.combinations(self._truths, 2))
        self.between_truths = sum(float(difference(a, b).mean()) for a, b in pairs) / len(pairs)

    def of(self, pictures: Tensor) -> float:
        """Ratio of pictures (L, 3, H, W) relit from the same directions; 1 is indistinguishable."""
        statistics = self._style(pictures)
        errors = [float(difference(statistics, truth).mean()) for truth in self._truths]
        return sum(errors) / len(errors) / self.between_truths
