"""Noise of a photograph's channels, as standard deviations of log radiance.

A developed photograph has 8-bit codes, whose step is large in dark channels: the logarithm of a
channel with a code of 1 or 2 is quantisation noise. The noise of a RAW is known from its sensor
model (photo/sensor_noise.py).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.piece.smooth import smoothed
from matcap.files.srgb import srgb_slope
from matcap.flash.plane import Plane

AROUND = 8.0  # texels, standard deviation of local averages
_ALIKE = 0.1  # log radiance added in quadrature to the noise before channels are weighted by it
DARKEST = 1e-5  # linear radiance below which logarithms are clamped
# Side of blocks in texels, and the share of blocks assumed to have no texture.
_BLOCK, _PLAIN_SHARE = 8, 0.1

Floats = NDArray[np.float32]


def channel_noise(plane: Plane) -> Tensor:
    """(3, H, W) standard deviation of log radiance by sensor noise or quantisation, at most 1.

    Local averages, so that it does not depend on a texel's own darkness.
    """
    linear = np.stack([smoothed(c, AROUND) for c in plane.linear.numpy()])
    if plane.noise is not None:
        drawn = plane.noise.square().numpy()
        deviation = np.sqrt(np.stack([smoothed(c, AROUND) for c in drawn]))
    elif plane.developed:
        deviation = code_step(linear)
    else:
        return torch.zeros_like(plane.linear)
    share = deviation / np.maximum(linear, np.maximum(deviation, np.float32(1e-9)))
    return torch.from_numpy(np.asarray(share, np.float32))


def channel_weights(noise: Tensor) -> Tensor:
    """(3, H, W) weights of the channels for a mean over them; they sum to 1."""
    weight = 1.0 / (noise.square() + _ALIKE**2)
    return weight / weight.sum(0, keepdim=True)


def code_step(linear: Floats) -> Floats:
    """Step of linear radiance (any shape) per 8-bit code, by the derivative of the sRGB curve."""
    return np.asarray(1.0 / (255.0 * srgb_slope(linear)), np.float32)


def noise_level(plane: Plane) -> float:
    """Noise standard deviation of grey log radiance, bounded by that of the smoothest blocks.

    Known for a RAW. For a developed picture, which is denoised by an unknown amount, the finest
    structure of the smoothest blocks is an upper bound.
    """
    noise = channel_noise(plane)
    weights = channel_weights(noise)
    of_mean = (weights * noise).square().sum(0)[plane.valid]
    known = float(of_mean.mean().sqrt()) if of_mean.numel() else 0.0
    return min(known, plainest(plane, weights)) if plane.developed else known


def plainest(plane: Plane, weights: Tensor) -> float:
    """Noise standard deviation of log radiance in the smoothest blocks.

    By mixed second differences, which vanish on f(x) + g(y) [immerkaer1996].
    """
    log = (weights * plane.linear.clamp_min(DARKEST).log()).sum(0)
    mixed = log[2:] - 2.0 * log[1:-1] + log[:-2]
    mixed = (mixed[:, 2:] - 2.0 * mixed[:, 1:-1] + mixed[:, :-2]) / 6.0
    side = min(_BLOCK, *mixed.shape)
    whole = plane.valid[1:-1, 1:-1].float()[None, None]
    squares = torch.nn.functional.avg_pool2d(mixed.square()[None, None], side)
    seen = torch.nn.functional.avg_pool2d(whole, side) == 1.0
    return float(squares[seen].quantile(_PLAIN_SHARE).sqrt()) if seen.any() else 0.0
