"""Comparison of registered photographs on the plane: correlation of texture, and sharpness.

Sharpness is the ratio of the amplitudes of the finest band and of a band of four times the
wavelength: defocus and motion lower it, light hardly affects it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.capture.registration.camera import PosedCamera, grid_points, to_pixels
from matcap.photo.photo import Photo
from matcap.photo.shrink import area_averaged

ChannelPlane = NDArray[np.float32]

# Settings of the comparison; docs/notes/several.md.
_COMPARED = 384  # texels across the grid of the correlation
_SHIFTED = 5  # shift in texels at which the correlation must be lower
_ACROSS = 640  # texels across the grid of sharpness
_TILES = 12  # tiles across
_FINE = (0.7, 1.4)  # standard deviations of the two Gaussians of the finest band, texels
_LONG = (2.8, 5.6)  # standard deviations of the two Gaussians of the longer band, texels


def texture_correlation(
    first: Photo, first_camera: PosedCamera, second: Photo, second_camera: PosedCamera
) -> float:
    """Correlation of the fine texture of two registered photographs over their overlap.

    In [-1, 1]; -1 without overlap, or if a shift by a few texels correlates better.
    """
    down = round(_COMPARED * first.pixels.shape[0] / first.pixels.shape[1])
    texture, inside = _texture(first, first_camera, down)
    other, other_inside = _texture(second, second_camera, down)
    both = inside & other_inside
    if both.mean() < 0.05:
        return -1.0

    def correlation(x: int, y: int) -> float:
        a, b = texture[both], np.roll(other, (y, x), (0, 1))[both]
        return float((a * b).mean() / max(float(np.sqrt((a * a).mean() * (b * b).mean())), 1e-9))

    far = _SHIFTED
    shifted = max(correlation(x, y) for x, y in ((far, 0), (-far, 0), (0, far), (0, -far)))
    aligned = correlation(0, 0)
    return aligned if aligned > shifted else -1.0


def _texture(
    photo: Photo, camera: PosedCamera, down: int
) -> tuple[ChannelPlane, NDArray[np.bool_]]:
    """(down, _COMPARED) high-passed log radiance over its local contrast on the plane, its mask."""
    size = (_COMPARED, down)
    log, inside = _log_on_grid(photo, camera, size, _COMPARED, 1e-5, cv2.INTER_LINEAR)
    fine = _band(log, 1.0, 6.0)
    contrast = np.sqrt(cv2.GaussianBlur(fine * fine, (0, 0), 12.0)) + 1e-4
    return (fine / contrast).astype(np.float32), inside


def losses_of_sharpness(photos: Sequence[Photo], cameras: Sequence[PosedCamera]) -> list[float]:
    """Log loss of sharpness of each photograph relative to the median one; positive is blurred.

    Compared where it and the first photograph overlap; 0 without overlap.
    """
    both = zip(photos, cameras, strict=True)
    first, *others = (_sharpness(photo, camera, photos[0]) for photo, camera in both)
    losses = []
    for each in (first, *others):
        seen = np.isfinite(each) & np.isfinite(first)
        losses.append(float(np.median((first - each)[seen])) if seen.sum() > 4 else 0.0)
    middle = sorted(losses)[(len(losses) - 1) // 2]  # of two, the sharper one
    return [loss - middle for loss in losses]


def _sharpness(photo: Photo, camera: PosedCamera, first: Photo) -> NDArray[np.float64]:
    """(tiles,) log sharpness on the first photograph's plane; NaN for a tile partly outside."""
    down = round(_ACROSS * first.pixels.shape[0] / first.pixels.shape[1])
    wide = min(photo.pixels.shape[1], _ACROSS)
    log, inside = _log_on_grid(photo, camera, (_ACROSS, down), wide, 1e-4, cv2.INTER_CUBIC)
    bands = (np.square(_band(log, *deviations)) for deviations in (_FINE, _LONG))
    tiles = (_TILES, max(2, round(_TILES * down / _ACROSS)))
    fine, long, seen = (
        area_averaged(each, tiles).ravel() for each in (*bands, inside.astype(np.float32))
    )
    ratio = 0.5 * np.log((fine + 1e-9) / (long + 1e-9))
    return np.where(seen > 0.99, ratio, np.nan).astype(np.float64)


def _band(plane: ChannelPlane, fine: float, coarse: float) -> ChannelPlane:
    """Difference of two Gaussian blurs of these standard deviations, texels."""
    near, far = (cv2.GaussianBlur(plane, (0, 0), deviation) for deviation in (fine, coarse))
    return np.asarray(near - far, np.float32)


def _log_on_grid(
    photo: Photo, camera: PosedCamera, size: tuple[int, int], wide: int, darkest: float, how: int
) -> tuple[ChannelPlane, NDArray[np.bool_]]:
    """(down, across) each: log radiance of a photograph on the plane's grid, and where it is seen.

    Args:
        photo: the photograph; the mean of its channels is looked up.
        camera: its camera.
        size: (across, down) texels of the grid.
        wide: pixels across to which the photograph is averaged before.
        darkest: radiance below which the logarithm is clamped.
        how: OpenCV interpolation.
    """
    rows, columns = photo.pixels.shape[:2]
    small = (wide, round(wide * rows / columns))
    grey = area_averaged(photo.pixels, small).mean(2)
    log = np.log(np.maximum(grey, darkest)).astype(np.float32)
    x, y = to_pixels(camera.sees(grid_points(*size)), *small)
    inside = (x > 1) & (x < small[0] - 2) & (y > 1) & (y < small[1] - 2)
    resampled = cv2.remap(log, x, y, how, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(resampled, np.float32), np.asarray(inside)
