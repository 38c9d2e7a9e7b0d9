"""The encoder [henzler2021]: a photograph to its latent vector, and its inputs."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from matcap.flash.alignment import PICTURE_CHANNELS, convolution, residual_block
from matcap.flash.coarse.fit import CoarseFit
from matcap.space.decoder import CODE_SIZE
from matcap.statistics.compare import (
    Descriptor,
    FilterBank,
    FilterBankConfig,
    describe,
    fit_encoding,
)

# The encoder: a flash photograph to mean and log-variance of its latent vector [henzler2021].
#
# Inputs are the logarithm of the photograph, image coordinates (a highlight's meaning depends on
# its position), parameters of the coarse fit, and texture statistics. Residual blocks [he2016] are
# fewer than the paper's, with group normalisation, as a batch has few materials.

NUMBERS = 16  # parameters of the coarse fit
TEXTURE = 231  # texture statistics at full resolution

_LEAST_LOG_VARIANCE, _MOST_LOG_VARIANCE = -8.0, 4.0  # of a dimension of the latent vector


@dataclass(frozen=True)
class EncoderConfig:
    """Input size of an encoder."""

    width: int = 256
    """Columns of the input image (512 in the paper); rows by the photograph's aspect."""


class Encoder(nn.Module):
    """The network: image and numbers to the latent vector's mean and log-variance."""

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        self.config = config
        self.features, channels = _features()
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
            picture: (B, PICTURE_CHANNELS, h, w) from flash.alignment.picture().
            numbers: (B, NUMBERS) from numbers().
            texture: (B, TEXTURE) from texture().
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


def _features() -> tuple[nn.Module, int]:
    widths = (32, 64, 96, 128, 192)
    layers: list[nn.Module] = [
        *convolution(PICTURE_CHANNELS, widths[0], 5, 2),
        nn.ReLU(inplace=True),
        *(residual_block(inputs, outputs, 2) for inputs, outputs in pairwise(widths)),
        residual_block(widths[-1], widths[-1], 1),
    ]
    return nn.Sequential(*layers), widths[-1]


# Encoder inputs besides the image: parameters of the coarse fit, and texture statistics.
#
# The encoder's image is too small to show fine texture. Autocorrelation, contrast and quantiles of
# windows at full resolution describe it.

FEATURES = FilterBankConfig(sizes=(5,), filters=64)  # of the texture loss in training
# Gram matrices are no inputs of the encoder; one filter keeps them small.
_ENCODER_BANK = FilterBankConfig(sizes=(5,), filters=1, crossed=False)
WINDOW = 96  # texels a side of the windows that statistics are computed of
_PLACES_ACROSS, _PLACES_DOWN = (0.1, 0.37, 0.63, 0.9), (0.15, 0.5, 0.85)
_LEVELS = 3  # pyramid levels, as many as a window of 64 texels has
_LAGS_DOWN = (0, 1, 2, 4, 7, 11)  # texels of a level, as are those across
_LAGS_ACROSS = (-11, -7, -4, -2, -1, 0, 1, 2, 4, 7, 11)
_QUANTILES = (1, 5, 12, 24, 39, 51, 58, 62)  # indices of 64
_STRONGEST = 2  # index of the encoded channel of most variance


def numbers(coarse: CoarseFit, contrast: Tensor, detail: int) -> Tensor:
    """(NUMBERS,) parameters of the coarse fit, each about standard normal.

    Args:
        contrast: (3,) from tuning.match.log_contrast.
        detail: texels across the photograph.
    """
    setup = coarse.setup
    values = [
        *(math.log(value) + 1.5 for value in coarse.diffuse),
        math.log(coarse.specular) + 3.0,
        4.0 * (coarse.roughness - 0.5),
        *(math.log(max(float(value), 1e-3)) + 2.0 for value in contrast),
        (setup.fov - 60.0) / 15.0,
        10.0 * setup.offset[0],
        10.0 * setup.offset[1],
        10.0 * setup.tilt[0],
        10.0 * setup.tilt[1],
        # The prior was trained with fits of r^2 alone, whose coefficient takes 0.7 of that of r^4.
        2.0 * (setup.vignetting + 0.7 * setup.vignetting_quartic),
        10.0 * coarse.residual,
        math.log2(detail / 1024.0),
    ]
    assert len(values) == NUMBERS
    return torch.tensor(values, dtype=torch.float32)


def texture(windows: Descriptor) -> Tensor:
    """(TEXTURE,) means over windows of autocorrelation, log variance and quantiles by level."""
    parts = []
    levels = zip(windows.spectra, windows.quantiles, strict=True)
    for spectra, quantiles in itertools.islice(levels, _LEVELS):
        reach = spectra.shape[-1] // 2
        variance = spectra[:, :, 0, reach].clamp_min(1e-4)
        rows = spectra[:, _STRONGEST][:, [min(lag, reach) for lag in _LAGS_DOWN]]
        columns = [reach + max(-reach, min(lag, reach)) for lag in _LAGS_ACROSS]
        strongest = variance[:, _STRONGEST]
        parts.append((rows[:, :, columns] / strongest[:, None, None]).flatten(1))
        parts.append(0.5 * variance.log())
        parts.append(quantiles[:, _STRONGEST][:, list(_QUANTILES)] / strongest.sqrt()[:, None])
    return torch.cat(parts, dim=1).float().mean(0).clamp(-4.0, 4.0)


def describe_windows(linear: Tensor, valid: Tensor) -> Descriptor:
    """Descriptor of windows on a 4 x 3 grid over a rectified photograph.

    Windows are WINDOW texels wide, or as wide as a smaller photograph; those of which less than
    half is valid are left out, unless all are.

    Args:
        linear: (3, H, W) radiance.
        valid: (H, W) bool.
    """
    height, width = linear.shape[-2:]
    side = min(WINDOW, height, width)
    corners = [
        (round(x * (width - side)), round(y * (height - side)))
        for y in _PLACES_DOWN
        for x in _PLACES_ACROSS
    ]
    shares = [float(valid[y : y + side, x : x + side].float().mean()) for x, y in corners]
    least = min(0.5, max(shares))
    windows = [
        linear[:, y : y + side, x : x + side]
        for (x, y), share in zip(corners, shares, strict=True)
        if share >= least
    ]
    return describe(torch.stack(windows), fit_encoding(linear, valid), FilterBank(_ENCODER_BANK))
