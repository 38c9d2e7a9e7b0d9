"""The encoder: a flash photograph to mean and log-variance of its latent vector [henzler2021].

Inputs are the logarithm of the photograph, image coordinates (a highlight's meaning depends on its
position), parameters of the coarse fit, and texture statistics. There are two backbones: "small",
the shipped one, and "resnet50" [he2016], the paper's. Both use group normalisation, as a batch has
few materials.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from matcap.errors import UsageError
from matcap.space.decoder import CODE_SIZE
from matcap.space.layers import Shortcut, convolution, residual_block
from matcap.space.picture import PICTURE_CHANNELS

NUMBERS = 16  # parameters of the coarse fit (space/prior/encoder_input.py)
TEXTURE = 231  # texture statistics at full resolution (space/prior/encoder_input.py)
BACKBONES = ("small", "resnet50")

_LEAST_LOG_VARIANCE, _MOST_LOG_VARIANCE = -8.0, 4.0  # of a dimension of the latent vector


@dataclass(frozen=True)
class EncoderConfig:
    """Backbone and input size of an encoder."""

    backbone: str = "small"
    """One of BACKBONES."""
    width: int = 256
    """Columns of the input image (512 in the paper); rows by the photograph's aspect."""


def bottleneck(inputs: int, outputs: int, stride: int) -> Shortcut:
    """ResNet-50's block: 1 x 1, 3 x 3, 1 x 1 convolutions with a shortcut."""
    inner = outputs // 4
    layers = [
        *convolution(inputs, inner, 1),
        nn.ReLU(inplace=True),
        *convolution(inner, inner, 3, stride),
        nn.ReLU(inplace=True),
        *convolution(inner, outputs, 1),
    ]
    return Shortcut(layers, inputs, outputs, stride)


class Encoder(nn.Module):
    """The network: image and numbers to the latent vector's mean and log-variance."""

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        if config.backbone not in BACKBONES:
            raise UsageError.at(
                "encoder",
                f"there is no backbone '{config.backbone}'",
                f"choose from {', '.join(BACKBONES)}",
            )
        self.config = config
        if config.backbone == "small":
            self.features, channels = _small()
        else:
            self.features, channels = _resnet50()
        hidden = 256
        self.numbers = nn.Sequential(nn.Linear(NUMBERS + TEXTURE, 192), nn.ReLU())
        self.hidden = nn.Sequential(nn.Linear(2 * channels + 192, hidden), nn.ReLU())
        self.head = nn.Linear(hidden, 2 * CODE_SIZE)
        # Initially means differ between photographs and variances are small, so that the decoder
        # can learn from the latent vectors.
        nn.init.normal_(self.head.weight[:CODE_SIZE], std=0.1)
        nn.init.zeros_(self.head.weight[CODE_SIZE:])
        nn.init.zeros_(self.head.bias)
        self.head.bias.data[CODE_SIZE:] = -3.0

    def forward(self, picture: Tensor, numbers: Tensor, texture: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance, (B, CODE_SIZE) each.

        Args:
            picture: (B, PICTURE_CHANNELS, h, w) from picture.picture().
            numbers: (B, NUMBERS) from encoder_input.numbers().
            texture: (B, TEXTURE) from encoder_input.texture().
        """
        features = self.features(picture.contiguous(memory_format=torch.channels_last))
        pooled = pool(features)
        embedded = self.numbers(torch.cat([numbers, texture], dim=1)).float()
        hidden = self.hidden(torch.cat([pooled, embedded], dim=1))
        mean, log_variance = self.head(hidden).float().chunk(2, dim=1)
        return mean, log_variance.clamp(_LEAST_LOG_VARIANCE, _MOST_LOG_VARIANCE)


def pool(features: Tensor) -> Tensor:
    """(B, 2 C) mean and standard deviation over h and w of (B, C, h, w), in float32."""
    variance, mean = torch.var_mean(features.float(), dim=(2, 3), correction=0)
    return torch.cat([mean, torch.sqrt(variance + 1e-5)], dim=1)


def _small() -> tuple[nn.Module, int]:
    widths = (32, 64, 96, 128, 192)
    layers: list[nn.Module] = [
        *convolution(PICTURE_CHANNELS, widths[0], 5, 2),
        nn.ReLU(inplace=True),
        *(residual_block(inputs, outputs, 2) for inputs, outputs in pairwise(widths)),
        residual_block(widths[-1], widths[-1], 1),
    ]
    return nn.Sequential(*layers), widths[-1]


def _resnet50() -> tuple[nn.Module, int]:
    layers: list[nn.Module] = [
        *convolution(PICTURE_CHANNELS, 64, 7, 2),
        nn.ReLU(inplace=True),
        nn.MaxPool2d(3, 2, 1),
    ]
    channels = 64
    for blocks, outputs, stride in ((3, 256, 1), (4, 512, 2), (6, 1024, 2), (3, 2048, 2)):
        for index in range(blocks):
            layers.append(bottleneck(channels, outputs, stride if index == 0 else 1))
            channels = outputs
    return nn.Sequential(*layers), channels
