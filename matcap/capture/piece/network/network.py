"""A U-Net from a flash photograph to departures of its maps from a uniform material.

Half the picture's resolution at its finest, by rearranging 2 x 2 texels into channels: at full
resolution only a thin head works. Fully convolutional; what must be told across the picture (gloss
to the rim, relief to the middle) goes through pooled context: means of every level's features,
plain and weighted by how much the light shows of relief and of gloss there, which scale and shift
the features of the way up.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

# Channels of the input, in this order (inputs.py).
INPUTS = (
    "red", "green", "blue", "valid", "light x", "light y", "shows x", "shows y",
    "shows roughness", "gloss", "roughness", "f0", "albedo", "relief x", "relief y",
)  # fmt: skip
COLOUR, SHOWN = slice(0, 3), slice(6, 8)  # log radiance; what it changes by with slope
GLOSS = 9  # share of the uniform material's radiance that is mirrored
_VALID, _GLOSS = slice(3, 4), slice(GLOSS, GLOSS + 1)
# Channels of the output: departures of log albedo, log F0 and logit roughness, height in texels,
# and the logarithm of the error to be expected of each (albedo, F0, roughness, slope).
OUTPUTS = 6
ERRORS = 4
_WEIGHTINGS = 3  # of the context's means: even, by what shows of relief, by gloss
_SLOPE = 0.2  # of LeakyReLU
_GROUPS = 4  # of channels that are normalised together


@dataclass(frozen=True)
class InverseConfig:
    """Shape of the network.

    Attributes:
        widths: channels at 1/2, 1/4, ... of the picture's resolution.
        context: channels of what is told across the picture.
    """

    widths: tuple[int, ...] = (32, 48, 64, 96, 128)
    context: int = 96

    @property
    def multiple(self) -> int:
        """Sides of the input must be multiples of this."""
        return 2 ** len(self.widths)


class Inverse(nn.Module):
    """The network; see the module."""

    def __init__(self, config: InverseConfig = InverseConfig()) -> None:
        super().__init__()
        self.config = config
        widths = config.widths
        self.stem = nn.Conv2d(4 * len(INPUTS), widths[0], 3, padding=1)
        before = (widths[0], *widths[:-1])
        self.down = nn.ModuleList(
            _ResidualBlock(last, width) for last, width in zip(before, widths, strict=True)
        )
        self.pooled = nn.ModuleList(
            nn.Linear(_WEIGHTINGS * width, config.context) for width in widths
        )
        self.context = nn.Sequential(
            nn.LeakyReLU(_SLOPE), nn.Linear(config.context, config.context), nn.LeakyReLU(_SLOPE)
        )
        self.merge = nn.ModuleList(
            nn.Conv2d(width + above, width, 1)
            for width, above in zip(widths[:-1], widths[1:], strict=True)
        )
        self.up = nn.ModuleList(_ResidualBlock(width, width) for width in widths[:-1])
        self.told = nn.ModuleList(nn.Linear(config.context, 2 * width) for width in widths[:-1])
        self.heights = nn.ModuleList(nn.Conv2d(width, 1, 3, padding=1) for width in widths[:-1])
        fine = 16
        self.head = nn.Conv2d(widths[0], 4 * fine, 3, padding=1)
        self.fine = nn.Conv2d(fine + len(INPUTS), fine, 3, padding=1)
        self.out = nn.Conv2d(fine, OUTPUTS + ERRORS, 3, padding=1)
        with torch.no_grad():
            for layer in (self.out, *self.heights, *self.told):
                layer.weight.mul_(0.1)
                assert layer.bias is not None
                layer.bias.zero_()

    def forward(self, inputs: Tensor) -> Tensor:
        """Read pictures.

        Args:
            inputs: (B, len(INPUTS), H, W), sides multiples of config.multiple.

        Returns:
            (B, OUTPUTS + ERRORS, H, W); see the names above.
        """
        weights = _weightings(inputs)
        x = self.stem(F.pixel_unshuffle(inputs, 2))
        levels, context = [], 0.0
        for index, (block, pooled) in enumerate(zip(self.down, self.pooled, strict=True)):
            if index:
                x = F.avg_pool2d(x, 2)
            x = block(x)
            levels.append(x)
            context = context + pooled(_means(x, F.avg_pool2d(weights, 2 ** (index + 1))))
        context = self.context(context)
        height: Tensor | None = None
        for index in reversed(range(len(levels) - 1)):
            x = F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
            x = self.merge[index](torch.cat([levels[index], x], dim=1))
            scale, shift = self.told[index](context)[..., None, None].chunk(2, dim=1)
            x = self.up[index](x * (1.0 + scale) + shift)
            # A wave twice as long is as steep at twice the height.
            here = self.heights[index](x) * 2.0**index
            if height is not None:
                here = here + F.interpolate(
                    height, scale_factor=2.0, mode="bilinear", align_corners=False
                )
            height = here
        assert height is not None
        fine = F.pixel_shuffle(self.head(x), 2)
        fine = F.leaky_relu(self.fine(torch.cat([fine, inputs], dim=1)), _SLOPE)
        out = self.out(fine)
        coarse = F.interpolate(height, scale_factor=2.0, mode="bilinear", align_corners=False)
        # The photograph's own departure is the first guess of albedo's.
        albedo = out[:, :3] + inputs[:, COLOUR]
        return torch.cat([albedo, out[:, 3:5], out[:, 5:6] + coarse, out[:, 6:]], dim=1)


class _ResidualBlock(nn.Module):
    """Two convolutions beside a shortcut, each after normalisation over the whole picture."""

    def __init__(self, before: int, width: int) -> None:
        super().__init__()
        self.before = nn.GroupNorm(_GROUPS, before)
        self.first = nn.Conv2d(before, width, 3, padding=1)
        self.between = nn.GroupNorm(_GROUPS, width)
        self.second = nn.Conv2d(width, width, 3, padding=1)
        self.shortcut = nn.Conv2d(before, width, 1) if before != width else nn.Identity()
        with torch.no_grad():
            self.second.weight.mul_(0.3)

    def forward(self, x: Tensor) -> Tensor:
        y = self.first(F.leaky_relu(self.before(x), _SLOPE))
        y = self.second(F.leaky_relu(self.between(y), _SLOPE))
        return self.shortcut(x) + y


def _weightings(inputs: Tensor) -> Tensor:
    """(B, _WEIGHTINGS, H, W): even, by what shows of relief, by gloss; of valid texels."""
    valid = inputs[:, _VALID] + 1e-3
    relief = inputs[:, SHOWN].square().sum(1, keepdim=True)
    return torch.cat([valid, valid * relief, valid * inputs[:, _GLOSS]], dim=1)


def _means(features: Tensor, weights: Tensor) -> Tensor:
    """(B, _WEIGHTINGS * C) weighted means of magnitudes."""
    total = weights.sum((2, 3)).clamp_min(1e-6)
    means = torch.einsum("bchw,bkhw->bkc", features.abs(), weights) / total[..., None]
    return means.flatten(1)
