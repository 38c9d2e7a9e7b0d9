"""Area downsampling in linear light, strip by strip, so that no full-size float copy is made."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Rows = tuple[NDArray[np.float32], NDArray[np.bool_]]
ReadRows = Callable[[int, int], Rows]

CLIPPED_SHARE = 0.25  # a shrunk pixel counts as clipped when this much of its area was
_STRIP_PIXELS = 1 << 20  # made linear in one go


def shrink(read: ReadRows, width: int, height: int, long_side: int | None) -> Rows:
    """Average a picture down to a long side, or take it as it is; it is never enlarged.

    Args:
        read: (first row, row after the last) -> linear pixels (n, W, 3) and clip mask (n, W).
        width, height: of the whole picture.
        long_side: of the result, pixels; None for the picture's own.

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
    # Columns first, a strip at a time: what is kept between the passes is already narrow.
    narrow = np.empty((height, new_width, 3), np.float32)
    narrow_mask = np.empty((height, new_width), np.float32)
    for top, bottom in strips:
        strip, mask = read(top, bottom)
        narrow[top:bottom] = _area(strip, new_width, bottom - top)
        narrow_mask[top:bottom] = _area(mask.astype(np.float32), new_width, bottom - top)
    share = _area(narrow_mask, new_width, new_height)
    # The margin is for float32 sums: exactly a quarter counts.
    return _area(narrow, new_width, new_height), share >= CLIPPED_SHARE - 1e-5


def shrunk_size(width: int, height: int, long_side: int | None) -> tuple[int, int]:
    """(width, height) whose longer one is long_side, of the same shape; never larger."""
    longest = max(width, height)
    if long_side is None or long_side >= longest:
        return width, height
    return max(1, round(width * long_side / longest)), max(1, round(height * long_side / longest))


def _area(picture: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    import cv2

    resized = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(resized, np.float32)
