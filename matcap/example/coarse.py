"""Coarse levels of detail: the place of the exemplar that each square of 2^level texels shows.

Places are synthesised coarse to fine, so a coarser level is where synthesis stops early. Beyond the
coarsest level each square shows the piece it begins with; neighbouring squares are independent
then. What is seen is near the mean of the finest texels, not that mean: seams that the finer levels
would move stay where they are.
"""

from __future__ import annotations

import numpy as np

from matcap.example.coordinates import begin, coordinates
from matcap.example.correction import Places
from matcap.example.example import Example, detail_bits
from matcap.field.plane import Rectangle


def coarse_places(example: Example, seed: int, level: int, area: Rectangle) -> Places:
    """(height, width, 2) int16: x, y of the exemplar's texel where each square begins.

    Args:
        example: the exemplar, indexed.
        seed: in [-2^63, 2^63).
        level: squares are 2^level texels wide.
        area: in squares.
    """
    bits, lookup = detail_bits(example.exemplar), example.lookup
    coarsest = len(lookup.levels) - 1
    depth = max(level - bits, 0)
    if level < bits:
        raise ValueError(f"level {level} is finer than the grid of places ({bits})")
    if depth <= coarsest:
        places = coordinates(lookup, seed, {depth: area}, None)[depth]
    else:
        step = depth - coarsest
        columns = np.arange(area.x, area.x + area.width) << step
        rows = np.arange(area.y, area.y + area.height) << step
        places = begin(lookup, seed, columns, rows, None)
    return places << np.int16(bits)
