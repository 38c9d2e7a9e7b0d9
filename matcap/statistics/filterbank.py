"""Features without learnt weights: random filters on a pyramid.

One layer of random zero-mean unit-norm filters of a few sizes, with ReLU, at every level of a
pyramid. Gram matrices of such features already describe a texture well (Ustyuzhaninov et al.
2016, "Texture Synthesis Using Shallow Convolutional Networks with Random Filters").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor


@dataclass(frozen=True)
class FilterBankConfig:
    """Which random filters.

    Attributes:
        sizes: filter sizes in texels, odd.
        filters: how many of each size.
        levels: pyramid levels, each half the size of the one before.
        crossed: features of neighbouring levels are compared together, too.
        seed: of the filters; the same seed gives the same filters everywhere.
    """

    sizes: tuple[int, ...] = (3, 5, 9)
    filters: int = 32
    levels: int = 5
    crossed: bool = True
    seed: int = 20210


class FilterBank:
    """Random filters, made once; apply them to images with `features`."""

    def __init__(self, config: FilterBankConfig, *, channels: int = 3) -> None:
        self.config = config
        generator = torch.Generator().manual_seed(config.seed)
        self.weights = []
        for size in config.sizes:
            weight = torch.randn(config.filters, channels, size, size, generator=generator)
            weight = weight - weight.mean(dim=(2, 3), keepdim=True)
            weight = weight / weight.flatten(1).norm(dim=1)[:, None, None, None]
            self.weights.append(weight.contiguous(memory_format=torch.channels_last))

    @property
    def levels(self) -> int:
        """Of the pyramid."""
        return self.config.levels

    @property
    def crossed(self) -> bool:
        """Whether features of neighbouring levels are compared together, too."""
        return self.config.crossed

    def maps(self, linear: Tensor, colours: Sequence[Tensor]) -> list[Tensor]:
        """Features of every level of a pyramid of colours."""
        del linear
        return [
            self.features(level.contiguous(memory_format=torch.channels_last)) for level in colours
        ]

    def features(self, image: Tensor) -> Tensor:
        """(B, filters * sizes, h, w) rectified responses of one pyramid level (B, C, H, W).

        Only where every filter lies inside, so nothing is invented at the border.
        """
        reach = max(self.config.sizes) // 2
        responses = []
        for size, weight in zip(self.config.sizes, self.weights, strict=True):
            cut = reach - size // 2
            inner = image[..., cut : image.shape[-2] - cut, cut : image.shape[-1] - cut]
            responses.append(F.conv2d(inner, weight.to(image)))
        return F.relu(torch.cat(responses, dim=1))


def pyramid(image: Tensor, levels: int, smallest: int = 16) -> list[Tensor]:
    """Levels of (B, C, H, W), each half the size; stops before a side falls under `smallest`."""
    stack = [image]
    while len(stack) < levels and min(stack[-1].shape[-2:]) // 2 >= smallest:
        stack.append(F.avg_pool2d(stack[-1], 2))
    return stack
