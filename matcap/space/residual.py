"""The residual block [he2016] of encoder and alignment branch."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

_GROUP = 16  # channels normalised together


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions with a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False),
            norm(outputs),
            nn.ReLU(inplace=True),
            nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False),
            norm(outputs),
        )
        self.shortcut = shortcut(inputs, outputs, stride)

    def forward(self, features: Tensor) -> Tensor:
        """(B, inputs, h, w) to (B, outputs, h / stride, w / stride)."""
        return F.relu(self.body(features) + self.shortcut(features))


def norm(channels: int) -> nn.GroupNorm:
    """Group normalisation in groups of _GROUP channels."""
    return nn.GroupNorm(channels // _GROUP, channels)


def shortcut(inputs: int, outputs: int, stride: int) -> nn.Module:
    """The skip connection: identity, or a 1 x 1 convolution where the shape changes."""
    if inputs == outputs and stride == 1:
        return nn.Identity()
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), norm(outputs))
