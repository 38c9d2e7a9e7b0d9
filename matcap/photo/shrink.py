"""Area downsampling of linear pixels, strip by strip, without a full-size float copy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = tuple[NDArray[np.float32], NDArray[np.bool_]]
ReadRows = Callable[[int, int], Rows]

CLIPPED_SHARE = 0.25  # clipped share of its area from which on a downsampled pixel is clipped
_STRIP_PIXELS = 1 << 20  # pixels of a strip


def shrink(read: ReadRows, width: int, height: int, long_side: int | None) -> Rows:
    """Downsample a picture by area averages; never upsample.

    Args:
        read: (first row, row after the last) -> linear pixels (n, W, 3) and clip mask (n, W).
        width, height: of the whole picture.
        long_side: of the result, pixels; None is the picture's own.

    Returns:
        pixels (h, w, 3) float32 and mask (h, w).
    """
    new_width, new_height = shrunk_size(width, height, long_side)
    step = max(1, _STRIP_PIXELS // width)
    strips = [(top, min(top + step, height)) for top in range(0, height, step)]
    if (new_width, new_height) == (width, height):
        pixels = np.empty((height, width, 3), np.float32)
        clipped = np.empty((height, width), np.bool_)
        for top, bottom in strips:
            pixels[top:bottom], clipped[top:bottom] = read(top, bottom)
        return pixels, clipped
    # Along rows first, strip by strip, so that the intermediate result is small.
    narrow = np.empty((height, new_width, 3), np.float32)
    narrow_mask = np.empty((height, new_width), np.float32)
    for top, bottom in strips:
        strip, mask = read(top, bottom)
        narrow[top:bottom] = area_averaged(strip, (new_width, bottom - top))
        narrow_mask[top:bottom] = area_averaged(mask.astype(np.float32), (new_width, bottom - top))
    share = area_averaged(narrow_mask, (new_width, new_height))
    # With a tolerance for rounding, so that exactly CLIPPED_SHARE counts.
    return area_averaged(narrow, (new_width, new_height)), share >= CLIPPED_SHARE - 1e-5


def shrunk_size(width: int, height: int, long_side: int | None) -> tuple[int, int]:
    """(width, height) scaled to a long side of at most long_side."""
    longest = max(width, height)
    if long_side is None or long_side >= longest:
        return width, height
    return max(1, round(width * long_side / longest)), max(1, round(height * long_side / longest))


def area_averaged(picture: NDArray[Any], size: tuple[int, ...]) -> NDArray[np.float32]:
    """A picture (H, W) or (H, W, C) shrunk to (width, height) by means over areas."""
    import cv2

    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


def cell_means(
    picture: NDArray[np.float32], columns: int, least_rows: int = 1
) -> NDArray[np.float32]:
    """Means of a picture (H, W) or (H, W, C) over about square cells, so many across."""
    height, width = picture.shape[:2]
    return area_averaged(picture, (columns, max(least_rows, round(columns * height / width))))
