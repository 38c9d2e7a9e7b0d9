"""How unlike two textures look to SqueezeNet: a measure that nothing is tuned by.

Gram matrices of its first convolution and its fire modules, at two scales. The distance of two Gram
matrices is relative,

    |A - B|_1 / ((|A|_1 + |B|_1) / 2),

and the measure is the mean over layers and scales: 0 for equal pictures, at most 2, and symmetric.
It sees open cells and broken threads, which a bank of linear filters hardly does. How much is
little, the floor says: the distance of two true pieces of one material. Over a whole picture true
pieces differ half as much as over a quarter of it, so the whole tells more (leather 0.12 and 0.19).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.lab.bench.style import Group, StyleStatistics, difference
from matcap.lab.floors.squeezenet import SqueezeNet
from matcap.statistics.gram import gram

SCALES = 2  # the second of half the size
_SMALLEST = 64  # texels a side at the coarser scale


class Measure:
    """The distance, with a network at hand."""

    def __init__(self, network: SqueezeNet | None = None) -> None:
        """Take a network; by default the one that comes along."""
        self._network = network or SqueezeNet.load()

    @torch.no_grad()
    def style(self, pictures: Tensor) -> StyleStatistics:
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

    def style_distance(self, first: Tensor, second: Tensor) -> float:
        """Of sRGB-encoded pictures (B, 3, H, W) in [0, 1] under the same lights."""
        return _mean(difference(self.style(first), self.style(second)))

    def floors(self, found: Tensor, truths: Sequence[Tensor]) -> float:
        """Error of pictures (L, 3, H, W) in multiples of the floor; 1 is indistinguishable.

        Args:
            found: relit from L directions.
            truths: two or more true pieces of the material, other than the photographed one,
                relit from the same directions.
        """
        return Floor([self.style(truth) for truth in truths]).of(self.style(found))


class Floor:
    """True pieces of one material, and what they differ by."""

    def __init__(self, truths: Sequence[StyleStatistics]) -> None:
        """Take the styles of two or more."""
        self._truths = tuple(truths)
        pairs = list(itertools.combinations(self._truths, 2))
        self.distance = sum(_mean(difference(a, b)) for a, b in pairs) / len(pairs)

    def of(self, found: StyleStatistics) -> float:
        """Error in multiples of the floor."""
        errors = [_mean(difference(found, truth)) for truth in self._truths]
        return sum(errors) / len(errors) / self.distance


def _mean(errors: Tensor) -> float:
    """Over the lights."""
    return float(errors.mean())
