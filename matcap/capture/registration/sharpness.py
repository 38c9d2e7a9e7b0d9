"""Detection of blurred photographs by comparison with others of the same texture.

Sharpness is the ratio of the amplitudes of the finest band and of a band of four times the
wavelength: defocus and motion lower it, light hardly affects it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.capture.registration.camera import PosedCamera, log_on_grid
from matcap.photo.photo import Photo
from matcap.photo.shrink import area_averaged

ChannelPlane = NDArray[np.float32]

# Settings of the detection of blurred photographs; docs/notes/several.md.

# Log loss of sharpness against the median from which a photograph is blurred; sharp ones vary by
# 0.14, a motion blur of a hundredth of the width is 0.28 and more.
BLURRED = 0.22
_ACROSS = 640  # texels across the grid of the comparison
_TILES = 12  # tiles across
_FINE = (0.7, 1.4)  # standard deviations of the two Gaussians of the finest band, texels
_LONG = (2.8, 5.6)  # standard deviations of the two Gaussians of the longer band, texels


def losses_of_sharpness(photos: Sequence[Photo], cameras: Sequence[PosedCamera]) -> list[float]:
    """Log loss of sharpness of each photograph relative to the median one; positive is blurred.

    Compared where it and the first photograph overlap; 0 without overlap.
    """
    both = zip(photos, cameras, strict=True)
    each_sharpness = [_sharpness(photo, camera, photos[0]) for photo, camera in both]
    first = each_sharpness[0]
    amounts = []
    for each in each_sharpness:
        seen = np.isfinite(each) & np.isfinite(first)
        amounts.append(float(np.median((first - each)[seen])) if seen.sum() > 4 else 0.0)
    middle = sorted(amounts)[(len(amounts) - 1) // 2]  # of two, the sharper one
    return [each - middle for each in amounts]


def _sharpness(photo: Photo, camera: PosedCamera, first: Photo) -> NDArray[np.float64]:
    """(tiles,) log sharpness on the first photograph's plane; NaN for a tile partly outside."""
    across = _ACROSS
    down = round(across * first.pixels.shape[0] / first.pixels.shape[1])
    wide = min(photo.pixels.shape[1], across)
    log, inside = log_on_grid(photo, camera, (across, down), wide, 1e-4, cv2.INTER_CUBIC)
    tiles = (_TILES, max(2, round(_TILES * down / across)))
    fine, long, seen = (
        area_averaged(each, tiles).ravel()
        for each in (_band(log, _FINE), _band(log, _LONG), inside.astype(np.float32))
    )
    ratio = 0.5 * np.log((fine + 1e-9) / (long + 1e-9))
    return np.where(seen > 0.99, ratio, np.nan).astype(np.float64)


def _band(log: NDArray[Any], deviations: tuple[float, float]) -> ChannelPlane:
    """Squared difference of two Gaussian blurs."""
    near, far = (cv2.GaussianBlur(log, (0, 0), deviation) for deviation in deviations)
    return np.asarray(np.square(near - far), np.float32)
