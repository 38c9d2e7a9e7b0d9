"""A tilted photograph as it would look from straight above: resampled on the plane's own grid."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.flash.geometry import FlashSetup, plane_points, project
from matcap.photo.photo import Photo


def rectify(photo: Photo, setup: FlashSetup, detail: int) -> tuple[Tensor, Tensor]:
    """Picture of the plane rectangle x in [-1, 1], `detail` texels across.

    Lighting is left as photographed: a texel keeps the radiance it had in the photograph.

    Args:
        photo: the photograph.
        setup: its geometry; only field of view and tilt matter here.
        detail: texels across the long side.

    Returns:
        linear (3, H, W) float32 and valid (H, W) bool: seen by the camera and not clipped.
    """
    height = round(detail * photo.pixels.shape[0] / photo.pixels.shape[1])
    size = (detail, height)
    if photo.pixels.shape[1] >= detail:
        small = cv2.resize(photo.pixels, size, interpolation=cv2.INTER_AREA)
    else:
        small = cv2.resize(photo.pixels, size, interpolation=cv2.INTER_CUBIC).clip(0.0)
    clipped = cv2.resize(photo.clipped.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    points = plane_points(0, 0, detail, height, size, dtype=torch.float64)
    image = project(points, setup).numpy()
    column = ((image[0] + 1.0) * detail / 2.0 - 0.5).astype(np.float32)
    row = (height / 2.0 - image[1] * detail / 2.0 - 0.5).astype(np.float32)
    linear = cv2.remap(small, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101).clip(
        0.0
    )
    covered = cv2.remap(clipped, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (column > -0.5) & (column < detail - 0.5) & (row > -0.5) & (row < height - 0.5)
    valid = inside & (covered < 0.25)
    return (
        torch.from_numpy(linear).permute(2, 0, 1).contiguous(),
        torch.from_numpy(valid),
    )
