"""Random framing, and a phone's sensor and processing: exposure, noise, tone curve, gradients.

Used for training photographs (inverse/samples.py, train/align.py).
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.brdf.maps import MapSet


def random_crop(maps: MapSet, width: int, height: int, rng: np.random.Generator) -> MapSet:
    """A crop of maps anywhere in them."""
    across, down = maps.size
    x, y = rng.integers(across - width + 1), rng.integers(down - height + 1)
    return maps.crop(int(x), int(y), width, height)


def exposure(radiance: Tensor, rng: np.random.Generator) -> float:
    """Random gain of radiance (3, H, W): mean at most 0.15 to 0.4, 0 to 4 % of pixels above 1."""
    share = rng.choice([0.0, 0.002, 0.01, 0.04], p=[0.4, 0.3, 0.2, 0.1])  # that is clipped
    bright = float(torch.quantile(radiance.amax(0)[::2, ::2].flatten(), 1.0 - share))
    gain = min(rng.uniform(0.15, 0.4) / float(radiance.mean()), rng.uniform(0.7, 1.0) / bright)
    return max(gain, 1.0 / bright) if share else gain


def contrast(linear: Tensor, power: float) -> Tensor:
    """Contrast as a power law about the median m: m (x / m)^power."""
    middle = float(linear.median().clamp_min(1e-4))
    return middle * (linear / middle).clamp_min(1e-4) ** power


def drift(
    height: int, width: int, rng: np.random.Generator, even: float, coloured: float
) -> Tensor:
    """(3, H, W) smooth random gain that varies in brightness and colour across the picture.

    Args:
        height, width: pixels.
        rng: random numbers.
        even, coloured: standard deviations of log gain, common to and independent by channel.
    """
    coarse = np.exp(rng.normal(0.0, even, (2, 3, 1)) + rng.normal(0.0, coloured, (2, 3, 3)))
    smooth = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
    return torch.from_numpy(smooth).permute(2, 0, 1)


def shoulder(linear: Tensor, bend: float) -> Tensor:
    """Highlight roll-off x (1 + bend) / (1 + bend x) below 1; values above are unchanged."""
    return torch.where(linear < 1.0, linear * (1.0 + bend) / (1.0 + bend * linear), linear)


def noisy(linear: Tensor, level: float, rng: np.random.Generator) -> Tensor:
    """Add shot and read noise and clip to [0, 1]; level 1 is a small sensor in dim light."""
    noise = torch.from_numpy(rng.standard_normal(tuple(linear.shape)).astype(np.float32))
    deviation = (linear.clamp_min(0.0) * (0.03 * level) ** 2 + (0.004 * level) ** 2).sqrt()
    return (linear + deviation * noise).clamp(0.0, 1.0)
