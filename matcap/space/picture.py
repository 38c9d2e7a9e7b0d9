"""Downsampled photograph and image coordinates: the image input of encoder and alignment branch."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

PICTURE_CHANNELS = 5  # log colour, and the two image coordinates
_TOE = 0.03  # added inside the logarithm, as a share of the median radiance


def picture(pixels: NDArray[np.float32], width: int) -> Tensor:
    """(5, h, width) of (H, W, 3) linear pixels: log_colour, then picture_coordinates."""
    height = round(width * pixels.shape[0] / pixels.shape[1])
    small = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
    linear = torch.from_numpy(np.ascontiguousarray(small.transpose(2, 0, 1)))
    return torch.cat([log_colour(linear), picture_coordinates(width, height)])


def log_colour(linear: Tensor) -> Tensor:
    """(3, h, w) log(L / median + 0.03) of linear radiance L; independent of the exposure."""
    median = linear.mean(0).median().clamp_min(1e-6)
    return torch.log(linear.clamp(0.0, 1.0) / median + _TOE)


def picture_coordinates(width: int, height: int) -> Tensor:
    """(2, h, w) coordinates of pixel centres: u right, in [-1, 1], v up, in the same unit."""
    u = (torch.arange(width) + 0.5) / width * 2.0 - 1.0
    v = (1.0 - (torch.arange(height) + 0.5) / height * 2.0) * height / width
    return torch.stack([u.expand(height, width), v[:, None].expand(height, width)])
