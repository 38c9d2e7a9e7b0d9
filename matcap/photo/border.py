"""Where a photograph's border is not what the rest of it is: a table's edge, another sheet.

Lines of cells along a side are medians of hue and brightness. A border is another thing where
between two of them there is a step such as nowhere in the middle, and all lines beyond it differ
from those before it. What drifts, as a flash's light does, has no step.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.files.values import Region
from matcap.photo.photo import Photo

Values = NDArray[np.float64]


@dataclass(frozen=True)
class BorderSettings:
    """When a border is another thing.

    Attributes:
        cells: along the long side: a step is as wide as one or two.
        least: log hue, log hue, log light: what a step must be.
        unlike: times the steps that nine of ten in the middle do not exceed, likewise.
        kept: of the step, that all lines beyond it must differ by.
        before: lines that they must differ from.
        most: of a side that is proposed to be cut off at each end.
        dark: of the median: bounds logarithms.
    """

    cells: int = 64
    least: tuple[float, float, float] = (0.15, 0.15, 0.35)
    unlike: float = 4.0
    kept: float = 0.6
    before: int = 4
    most: float = 0.3
    dark: float = 0.15


BORDER = BorderSettings()


def border_crop(photo: Photo) -> Region | None:
    """What of a photograph is like its middle, in its file's pixels as it is looked at.

    None where all of it is.
    """
    looks = _looks(photo.pixels)
    rows, columns = looks.shape[1:]
    ends = [_cut(looks.transpose(0, 2, 1)), _cut(looks.transpose(0, 2, 1)[:, ::-1])]
    ends += [_cut(looks), _cut(looks[:, ::-1])]
    if not any(ends):
        return None
    left, right, top, bottom = ends
    # Shares of what lies; turned back a quarter clockwise where the photograph stands.
    box = (left / columns, 1.0 - right / columns, top / rows, 1.0 - bottom / rows)
    if photo.turned:
        box = (1.0 - box[3], 1.0 - box[2], box[0], box[1])
    width, height = photo.original_size
    x, y = round(box[0] * width), round(box[2] * height)
    return Region(x, y, round(box[1] * width) - x, round(box[3] * height) - y)


def _looks(pixels: NDArray[np.float32]) -> Values:
    """(3, rows, columns) of cells: two log hues, and log light."""
    height, width = pixels.shape[:2]
    columns = min(BORDER.cells, width)
    rows = max(8, round(columns * height / width))
    small = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64)
    log = np.log(small + BORDER.dark * float(np.median(small)) + 1e-9)
    return np.stack([log[..., 0] - log[..., 1], log[..., 2] - log[..., 1], log.mean(axis=-1)])


def _cut(looks: Values) -> int:
    """How many of the first lines of cells (3, lines, along) are another thing."""
    _, count, along = looks.shape
    lines = np.median(looks[:, :, along // 8 : along - along // 8], axis=2)
    steps = np.abs(lines[:, 2:] - lines[:, :-2])  # across line k + 1
    usual = np.quantile(steps[:, count // 4 : count - count // 4], 0.9, axis=1)
    limit = np.maximum(BORDER.least, BORDER.unlike * usual)[:, None]
    most = int(BORDER.most * count)
    over = (steps[:, :most] / limit).max(axis=0)
    for at in np.argsort(-over):
        if over[at] <= 1.0:
            break
        look = int(np.argmax(steps[:, at] / limit[:, 0]))
        inside = lines[look, at + 2 : at + 2 + BORDER.before]
        beyond = lines[look, : at + 1] - np.median(inside)
        sign = np.sign(beyond[at])
        if (sign * beyond > BORDER.kept * limit[look, 0]).all():
            return int(at) + 2
    return 0
