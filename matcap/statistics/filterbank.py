"""Features without learnt weights: random filters on a pyramid.

One layer of random zero-mean unit-norm filters of several sizes, with ReLU, at every level of a
pyramid. Gram matrices of such features suffice for texture synthesis [ustyuzhaninov2016].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import BackwardCFunction, FunctionCtx, once_differentiable


@dataclass(frozen=True)
class FilterBankConfig:
    """Sizes and number of the random filters."""

    sizes: tuple[int, ...] = (3, 5, 9)
    """Filter sizes in texels, odd."""
    filters: int = 32
    """Number of filters of each size."""
    levels: int = 5
    """Pyramid levels, each half the size of the one before."""
    crossed: bool = True
    """Whether covariances between successive levels are used."""
    seed: int = 20210
    """Seed of the random generator."""


class FilterBank:
    """Random filters for images of three channels; implements compare.Features."""

    def __init__(self, config: FilterBankConfig) -> None:
        self.config = config
        generator = torch.Generator().manual_seed(config.seed)
        self.weights = []
        for size in config.sizes:
            weight = torch.randn(config.filters, 3, size, size, generator=generator)
            weight = weight - weight.mean(dim=(2, 3), keepdim=True)
            weight = weight / weight.flatten(1).norm(dim=1)[:, None, None, None]
            self.weights.append(weight.contiguous(memory_format=torch.channels_last))

    @property
    def levels(self) -> int:
        """Number of pyramid levels."""
        return self.config.levels

    @property
    def crossed(self) -> bool:
        """Whether covariances between successive levels are used."""
        return self.config.crossed

    def maps(self, linear: Tensor, colours: Sequence[Tensor]) -> list[Tensor]:
        """features() of every level of a colour pyramid."""
        del linear
        return [
            self.features(level.contiguous(memory_format=torch.channels_last)) for level in colours
        ]

    def features(self, image: Tensor) -> Tensor:
        """(B, filters * sizes, h, w) rectified responses of one pyramid level (B, C, H, W).

        Without padding: (h, w) is (H, W) less the largest filter size plus 1.
        """
        radius = max(self.config.sizes) // 2
        responses = []
        for size, weight in zip(self.config.sizes, self.weights, strict=True):
            cut = radius - size // 2
            inner = image[..., cut : image.shape[-2] - cut, cut : image.shape[-1] - cut]
            responses.append(_rectified(inner, weight.to(image)))
        return responses[0] if len(responses) == 1 else torch.cat(responses, dim=1)


def _rectified(image: Tensor, weight: Tensor) -> Tensor:
    # torch leaves apply untyped.
    responses: Tensor = _Rectified.apply(image, weight)  # type: ignore[no-untyped-call]
    return responses


class _Rectified(torch.autograd.Function):
    """ReLU of a convolution, differentiable by the image but not by the filters.

    The gradient is one matrix product and a sum of shifted planes; for the few channels of an image
    that takes a quarter of the time of the convolution's own gradient.
    """

    @staticmethod
    def forward(ctx: FunctionCtx, image: Tensor, weight: Tensor) -> Tensor:
        responses = F.relu_(F.conv2d(image, weight))
        ctx.save_for_backward(responses, weight)
        ctx.shape = image.shape  # type: ignore[attr-defined]
        return responses

    @staticmethod
    @once_differentiable
    def backward(ctx: BackwardCFunction, gradient: Tensor) -> tuple[Tensor, None]:
        saved: tuple[Tensor, ...] = ctx.saved_tensors
        responses, weight = saved
        seen = torch.ops.aten.threshold_backward(gradient, responses, 0.0)
        rows = seen.permute(0, 2, 3, 1).flatten(1, 2)
        side = weight.shape[-1]
        height, width = responses.shape[2:]
        taps = weight.permute(2, 3, 1, 0).flatten(0, 2).to(rows)
        shifted = (taps @ rows.transpose(1, 2)).unflatten(2, (height, width))
        shifted = shifted.unflatten(1, (side, side, -1))
        back = weight.new_zeros(ctx.shape)  # type: ignore[attr-defined]
        for y in range(side):
            for x in range(side):
                back[..., y : y + height, x : x + width] += shifted[:, y, x]
        return back, None


def pyramid(image: Tensor, levels: int) -> list[Tensor]:
    """Levels of (B, C, H, W), each half the size; stops before a side falls under 16."""
    stack = [image]
    while len(stack) < levels and min(stack[-1].shape[-2:]) // 2 >= 16:
        stack.append(F.avg_pool2d(stack[-1], 2))
    return stack
