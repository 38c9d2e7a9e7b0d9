"""Coarse levels of detail: for each square of 2^level texels, a place of the exemplar.

Synthesis runs from coarse to fine, so that a coarse level is a prefix of it. Beyond the coarsest
level each square has its initial patch, independent of its neighbours. The result is close to, but
not exactly, the mean of the finest level, whose corrections move seams.
"""

from __future__ import annotations

import numpy as np

from matcap.example.coordinates import coordinates, initial_places
from matcap.example.correction import Places
from matcap.example.example import Example, detail_bits
from matcap.field.plane import Rectangle


def coarse_places(example: Example, seed: int, level: int, area: Rectangle) -> Places:
    """(height, width, 2) int16: x, y of the exemplar at each square's upper left texel.

    Args:
        example: the indexed exemplar.
        seed: in [-2^63, 2^63).
        level: squares are 2^level texels wide; at least detail_bits of the exemplar.
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
        places = initial_places(lookup, seed, columns, rows, None)
    return places << np.int16(bits)
