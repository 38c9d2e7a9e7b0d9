"""Seam contrast of a field: differences across seams over differences inside the exemplar.

Style distance is blind to a cut. So each pair of neighbouring texels that the exemplar did not show
side by side is asked how far it differs, in log albedo and in slope, and that is divided by what
the exemplar's own neighbours differ by: 1 where seams are indistinguishable.
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
    """Differences of neighbours at seams over those of the exemplar's own neighbours.

    Attributes:
        median: of all pairs' differences, over the exemplar's median.
        high: their 99th percentile over the exemplar's.
    """

    median: float
    high: float


def seam_contrast(
    maps: Floats, places: NDArray[np.int64], exemplar: Floats, texel_size: float
) -> dict[str, SeamContrast] | None:
    """Of "albedo" (log, over its channels) and "slope"; None where there are hardly any seams.

    Args:
        maps: (6 or 8, H, W) of the field.
        places: (H, W, 2) x, y of the exemplar that each texel shows, in texels of it.
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
    """How far neighbours along each axis differ: the root of the sum of squares over planes."""
    return [np.sqrt(np.square(np.diff(planes, axis=axis)).sum(axis=0)) for axis in (1, 2)]
