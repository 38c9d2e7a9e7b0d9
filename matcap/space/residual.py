"""Residual blocks [he2016] of encoder and alignment branch."""

from __future__ import annotations

from collections.abc import Sequence

import torch.nn.functional as F
from torch import Tensor, nn

_GROUP = 16  # channels normalised together


class Shortcut(nn.Module):
    """Layers with a shortcut: identity, or a 1 x 1 convolution where the shape changes."""

    def __init__(self, layers: Sequence[nn.Module], inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.body = nn.Sequential(*layers)
        self.shortcut: nn.Module = nn.Identity()
        if inputs != outputs or stride != 1:
            self.shortcut = nn.Sequential(*convolution(inputs, outputs, 1, stride))

    def forward(self, features: Tensor) -> Tensor:
        """(B, inputs, h, w) to (B, outputs, h / stride, w / stride)."""
        return F.relu(self.body(features) + self.shortcut(features))


def residual_block(inputs: int, outputs: int, stride: int) -> Shortcut:
    """Two 3 x 3 convolutions with a shortcut."""
    layers = [
        *convolution(inputs, outputs, 3, stride),
        nn.ReLU(inplace=True),
        *convolution(outputs, outputs, 3),
    ]
    return Shortcut(layers, inputs, outputs, stride)


def convolution(inputs: int, outputs: int, side: int, stride: int = 1) -> list[nn.Module]:
    """A convolution with group normalisation."""
    return [
        nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False),
        nn.GroupNorm(outputs // _GROUP, outputs),
    ]
