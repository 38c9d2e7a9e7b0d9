"""Seam contrast of a field: differences across seams over differences inside the exemplar.

Style distances hardly respond to seams. A seam is a pair of neighbouring texels whose source texels
are not neighbours in the exemplar. Seam contrast is a quantile of the differences across seams, in
log albedo or in slope, over the same quantile of the exemplar's: 1 is indistinguishable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import DIFFUSE, HEIGHT, Floats

_DARKEST = 1e-3  # albedo
_FEWEST = 100  # pairs: with fewer, no value


@dataclass(frozen=True)
class SeamContrast:
    """Differences across seams over differences between neighbours of the exemplar.

    Attributes:
        median: ratio of the medians.
        high: ratio of the 99th percentiles.
    """

    median: float
    high: float


def seam_contrast(
    maps: Floats, places: NDArray[np.int64], exemplar: Floats, texel_size: float
) -> dict[str, SeamContrast] | None:
    """Seam contrast of "albedo" (log, RGB) and "slope"; None where there are too few seams.

    Args:
        maps: (6 or 8, H, W) of the field.
        places: (H, W, 2) x, y of each texel's source in the exemplar, texels.
        exemplar: (6 or 8, h, w) maps.
        texel_size: in plane units.
    """
    seams = [
        (np.diff(places, axis=axis) != step).any(axis=-1)
        for axis, step in ((0, (0, 1)), (1, (1, 0)))
    ]
    if sum(int(some.sum()) for some in seams) < _FEWEST:
        return None
    contrasts = {}
    for name, here, own in zip(
        ("albedo", "slope"), _seen(maps, texel_size), _seen(exemplar, texel_size), strict=True
    ):
        there = [steps[some] for steps, some in zip(_steps(here), seams, strict=True)]
        at_seams = np.quantile(np.concatenate(there), (0.5, 0.99))
        usual = np.quantile(np.concatenate([one.ravel() for one in _steps(own)]), (0.5, 0.99))
        median, high = at_seams / np.maximum(usual, 1e-9)
        contrasts[name] = SeamContrast(float(median), float(high))
    return contrasts


def _seen(maps: Floats, texel_size: float) -> tuple[Floats, Floats]:
    """(3, H, W) log albedo and (2, H, W) slopes."""
    height = maps[HEIGHT][0] / np.float32(texel_size)
    slopes = np.stack([np.gradient(height, axis=axis) for axis in (0, 1)])
    return np.log(np.maximum(maps[DIFFUSE], _DARKEST)), slopes


def _steps(planes: Floats) -> list[Floats]:
    """Euclidean distance over channels between neighbours, along y and along x."""
    return [np.sqrt(np.square(np.diff(planes, axis=axis)).sum(axis=0)) for axis in (1, 2)]
