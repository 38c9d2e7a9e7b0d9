"""Rectification: a photograph resampled on the plane's grid by homography, viewed from above.

A texel is an area average. To keep sharpness, the photograph is resampled on a finer grid with
cubic interpolation and then averaged over texels; downsampling before a subpixel shift would lose
half of the amplitude of the finest texture.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.flash.geometry import FlashSetup, setup_rotation
from matcap.photo.photo import Photo
from matcap.photo.shrink import CLIPPED_SHARE, area_averaged

FINER = 2  # samples along the side of a texel, if the photograph has more pixels than texels
MOST_LEFT_OUT = 0.02  # largest masked share of a valid texel, and largest clipped one of a cell


def rectify(photo: Photo, setup: FlashSetup, detail: int) -> tuple[Tensor, Tensor]:
    """Resample a photograph to the plane rectangle x in [-1, 1]; radiance is not changed.

    Args:
        photo: the photograph.
        setup: its geometry; only field of view and tilt matter here.
        detail: texels along the long side.

    Returns:
        linear (3, H, W) float32 and valid (H, W) bool: inside of the photograph and not clipped.
    """
    linear = _resampled(photo.pixels, setup, detail, cv2.INTER_CUBIC).clip(0.0)
    clipped = _resampled(photo.clipped.astype(np.float32), setup, detail, cv2.INTER_LINEAR)
    valid = inside(linear.shape[:2], setup) & (clipped < CLIPPED_SHARE)
    valid &= kept(photo, setup, detail)
    return planes_of(linear), torch.from_numpy(valid)


def measured(photo: Photo, setup: FlashSetup, detail: int) -> Tensor:
    """(3, H, W) bool: where each channel is inside of the photograph and not clipped.

    A sparkle clipped in red can still be valid in green and blue.
    """
    clipped = _resampled(photo.full.astype(np.float32), setup, detail, cv2.INTER_LINEAR)
    seen = inside(clipped.shape[:2], setup)[..., None] & (clipped < CLIPPED_SHARE)
    seen &= kept(photo, setup, detail)[..., None]
    return planes_of(seen)


def rectify_noise(photo: Photo, setup: FlashSetup, detail: int) -> Tensor | None:
    """(3, H, W) noise sample of a photograph, resampled as by `rectify`; None if unknown."""
    if photo.noise is None:
        return None
    return planes_of(_resampled(photo.noise, setup, detail, cv2.INTER_CUBIC))


def kept(photo: Photo, setup: FlashSetup, detail: int) -> NDArray[np.bool_]:
    """(H, W) bool, texels wholly within the material's mask; (1, 1) True without a mask."""
    if photo.left_out is None:
        return np.ones((1, 1), np.bool_)
    share = _resampled(photo.left_out.astype(np.float32), setup, detail, cv2.INTER_LINEAR)
    return np.asarray(share < MOST_LEFT_OUT)


def _resampled(
    picture: NDArray[np.float32], setup: FlashSetup, detail: int, how: int
) -> NDArray[np.float32]:
    """Resample a picture to the plane's grid, (H, W) or (H, W, 3); cubic may overshoot."""
    rows, columns = picture.shape[:2]
    finer = FINER if columns > detail else 1
    fine = (finer * detail, finer * round(detail * rows / columns))
    shrunk = picture
    if columns > fine[0]:
        shrunk = area_averaged(picture, fine)
    seen = cv2.warpPerspective(
        shrunk,
        _homography(setup, fine, (shrunk.shape[1], shrunk.shape[0])),
        fine,
        flags=how | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    size = (detail, fine[1] // finer)
    return area_averaged(seen, size)


def inside(shape: tuple[int, ...], setup: FlashSetup) -> NDArray[np.bool_]:
    """(H, W) bool, texels inside of the picture; `rectify` mirrors the others at its border."""
    height, width = shape
    column, row = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)[:, None]
    x, y, w = (
        a * column + (b * row + c)
        for a, b, c in _homography(setup, (width, height), (width, height))
    )
    return (x > -0.5 * w) & (x < (width - 0.5) * w) & (y > -0.5 * w) & (y < (height - 0.5) * w)


def _homography(
    setup: FlashSetup, plane: tuple[int, int], picture: tuple[int, int]
) -> NDArray[np.float64]:
    """(3, 3) from texels of a plane's grid to pixels of a picture, (column, row, 1) both.

    `geometry.project` in homogeneous coordinates; sizes are (width, height).
    """
    turn = setup_rotation(setup, torch.float64).numpy()
    projected = np.array(
        [
            [setup.distance * turn[0, 0], setup.distance * turn[0, 1], 0.0],
            [setup.distance * turn[1, 0], setup.distance * turn[1, 1], 0.0],
            [-turn[2, 0], -turn[2, 1], setup.distance],
        ]
    )
    return _centred(picture) @ projected @ np.linalg.inv(_centred(plane))


def _centred(size: tuple[int, int]) -> NDArray[np.float64]:
    """(3, 3) from coordinates whose long side is [-1, 1], y upwards, to a grid's (column, row)."""
    width, height = size
    return np.array(
        [
            [width / 2.0, 0.0, width / 2.0 - 0.5],
            [0.0, -width / 2.0, height / 2.0 - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )


def planes_of(picture: NDArray[Any]) -> Tensor:
    """(H, W, C) to (C, H, W)."""
    return torch.from_numpy(picture).permute(2, 0, 1).contiguous()


def picture_of(planes: Tensor) -> NDArray[np.float32]:
    """(C, H, W) to (H, W, C)."""
    picture: NDArray[np.float32] = planes.permute(1, 2, 0).contiguous().numpy()
    return picture
