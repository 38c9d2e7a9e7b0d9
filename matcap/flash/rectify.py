"""A tilted photograph as it would look from straight above: resampled on the plane's own grid."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
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
    column, row = _sources(photo, setup, detail)
    height = len(row)
    linear = _resampled(photo.pixels, column, row).clip(0.0)
    clipped = cv2.resize(
        photo.clipped.astype(np.float32), (detail, height), interpolation=cv2.INTER_AREA
    )
    covered = cv2.remap(clipped, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (column > -0.5) & (column < detail - 0.5) & (row > -0.5) & (row < height - 0.5)
    valid = inside & (covered < 0.25)
    return _planes(linear), torch.from_numpy(valid)


def rectify_noise(photo: Photo, setup: FlashSetup, detail: int) -> Tensor | None:
    """(3, H, W) the photograph's noise as `rectify` makes it; None where it is not known."""
    if photo.noise is None:
        return None
    return _planes(_resampled(photo.noise, *_sources(photo, setup, detail)))


def _sources(
    photo: Photo, setup: FlashSetup, detail: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(H, W) column and row of the shrunk photograph that each texel is seen at."""
    height = round(detail * photo.pixels.shape[0] / photo.pixels.shape[1])
    points = plane_points(0, 0, detail, height, (detail, height), dtype=torch.float64)
    image = project(points, setup).numpy()
    column = ((image[0] + 1.0) * detail / 2.0 - 0.5).astype(np.float32)
    row = (height / 2.0 - image[1] * detail / 2.0 - 0.5).astype(np.float32)
    return column, row


def _resampled(
    picture: NDArray[np.float32], column: NDArray[np.float32], row: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(H, W, 3) a picture on the plane's grid; cubic, so that it may overshoot."""
    height, detail = column.shape
    how = cv2.INTER_AREA if picture.shape[1] >= detail else cv2.INTER_CUBIC
    small = cv2.resize(picture, (detail, height), interpolation=how)
    resampled = cv2.remap(small, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(resampled, np.float32)


def _planes(picture: NDArray[np.float32]) -> Tensor:
    return torch.from_numpy(picture).permute(2, 0, 1).contiguous()
