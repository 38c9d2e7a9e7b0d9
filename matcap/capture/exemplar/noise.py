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

from matcap.capture.exemplar.filters import smoothed
from matcap.files.srgb import srgb_slope
from matcap.flash.plane import Plane

AROUND = 8.0  # texels, standard deviation of local averages
# Log radiance added in quadrature to the noise before channels are weighted by it. Fine detail of a
# JPEG is the same difference of codes in all channels: too much contrast in the dark ones of a
# saturated colour, which 0.1 passes on to the others.
_COMMON_NOISE = 0.02

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
    weight = 1.0 / (noise.square() + _COMMON_NOISE**2)
    return weight / weight.sum(0, keepdim=True)


def code_step(linear: Floats) -> Floats:
    """Step of linear radiance (any shape) per 8-bit code, by the derivative of the sRGB curve."""
    return np.asarray(1.0 / (255.0 * srgb_slope(linear)), np.float32)
