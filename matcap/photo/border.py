"""Detects a border that is not the material, such as a table's edge or another sheet.

The photograph is averaged to cells; each line of cells along a side is reduced to the medians of
two log hues and log brightness. A border begins at a step between lines that is larger than those
in the middle, if all lines beyond it differ from those before it. The gradual falloff of a flash
has no such step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.files.values import Rectangle
from matcap.photo.photo import Photo
from matcap.photo.shrink import area_averaged

Values = NDArray[np.float64]

# Thresholds of a border.
_CELLS = 64  # along the long side; a step is one or two cells wide
_LEAST = (0.15, 0.15, 0.35)  # least step of the two log hues and log brightness
_UNLIKE = 4.0  # least ratio of a step to the 0.9 quantile of those in the middle
_KEPT = 0.6  # share of that limit by which all lines beyond must differ
_BEFORE = 4  # number of lines that they are compared with
_MOST = 0.3  # largest share of a side to crop at each end
_DARK = 0.15  # added inside logarithms, as a share of the median


def border_crop(photo: Photo) -> Rectangle | None:
    """The crop that removes borders, in pixels of the file's upright picture; None without any."""
    cells = _cells(photo.pixels)
    rows, columns = cells.shape[1:]
    ends = [_cut(cells.transpose(0, 2, 1)), _cut(cells.transpose(0, 2, 1)[:, ::-1])]
    ends += [_cut(cells), _cut(cells[:, ::-1])]
    if not any(ends):
        return None
    left, right, top, bottom = ends
    # Shares of the landscape picture, rotated back for portraits.
    box = (left / columns, 1.0 - right / columns, top / rows, 1.0 - bottom / rows)
    if photo.turned:
        box = (1.0 - box[3], 1.0 - box[2], box[0], box[1])
    width, height = photo.original_size
    x, y = round(box[0] * width), round(box[2] * height)
    return Rectangle(x, y, round(box[1] * width) - x, round(box[3] * height) - y)


def _cells(pixels: NDArray[np.float32]) -> Values:
    """(3, rows, columns) cells: log(R / G), log(B / G), mean log radiance."""
    height, width = pixels.shape[:2]
    columns = min(_CELLS, width)
    rows = max(8, round(columns * height / width))
    small = area_averaged(pixels, (columns, rows)).astype(np.float64)
    log = np.log(small + _DARK * float(np.median(small)) + 1e-9)
    return np.stack([log[..., 0] - log[..., 1], log[..., 2] - log[..., 1], log.mean(axis=-1)])


def _cut(cells: Values) -> int:
    """Number of first lines of cells (3, lines, along) that are a border."""
    _, count, along = cells.shape
    lines = np.median(cells[:, :, along // 8 : along - along // 8], axis=2)
    steps = np.abs(lines[:, 2:] - lines[:, :-2])  # across line k + 1
    usual = np.quantile(steps[:, count // 4 : count - count // 4], 0.9, axis=1)
    limit = np.maximum(_LEAST, _UNLIKE * usual)[:, None]
    most = int(_MOST * count)
    over = (steps[:, :most] / limit).max(axis=0)
    for at in np.argsort(-over):
        if over[at] <= 1.0:
            break
        plane = int(np.argmax(steps[:, at] / limit[:, 0]))
        inside = lines[plane, at + 2 : at + 2 + _BEFORE]
        beyond = lines[plane, : at + 1] - np.median(inside)
        sign = np.sign(beyond[at])
        if (sign * beyond > _KEPT * limit[plane, 0]).all():
            return int(at) + 2
    return 0
