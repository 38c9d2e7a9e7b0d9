"""Environment maps prefiltered by lobe width, in octahedral parametrisation [engelhardt2008].

A mip pyramid; a lookup is bilinear within one level. Box filter and bilinear kernel together add
1/4 texel^2 of variance along each axis, which blunts smooth maxima. Each level is therefore
sharpened by 3/2 - 1/8 (sum of four neighbours): lookups are then exact for radiance that is
quadratic over a few texels, and small bright spots still count in full.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from matcap.relight.loops.library import KeptArrays
from matcap.relight.loops.structures import CEnvironment
from matcap.relight.vectors import Array, Vec

_FINEST, _COARSEST = 1024, 4
# Samples along a texel's side of the finest level.
_RAYS = 2


@dataclass(frozen=True)
class Octahedra:
    """All levels in one picture, each with a border of one texel that continues it."""

    atlas: Array
    """(h, w, 3) float32 radiance, levels from the finest at the top."""
    tops: Array
    """(levels,) first row of each level in the atlas."""
    sides: Array
    """(levels,) texels along a side of each level, border excluded."""

    def as_c(self) -> CEnvironment:
        """The levels as a C structure (loops/structures.py)."""
        kept, width = KeptArrays(), self.atlas.shape[1]
        arrays = (kept.of(one) for one in (self.atlas, self.tops, self.sides))
        # Square root of the mean solid angle of a texel of the finest level, in radians.
        finest = math.sqrt(4.0 * math.pi) / float(self.sides[0])
        return kept.kept_by(CEnvironment(*arrays, width, len(self.sides), finest))


def unfolded(u: Array, v: Array) -> Vec:
    """Unit vectors of places (u, v) in [-1, 1]^2 on the octahedral map; z > 0 in its middle."""
    z = 1.0 - np.abs(u) - np.abs(v)
    fold = np.maximum(-z, 0.0)
    x, y = u - np.copysign(fold, u), v - np.copysign(fold, v)
    inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
    return x * inverse, y * inverse, z * inverse


def octahedra(radiance: Callable[[Vec], Array], rows: int) -> Octahedra:
    """Sample a radiance function into a pyramid of octahedral maps.

    Args:
        radiance: (3, ...) radiance along unit vectors.
        rows: of the latitude-longitude map behind it: the finest level is about as fine.
    """
    side = min(max(2 ** math.ceil(math.log2(1.13 * rows)), 2 * _COARSEST), _FINEST)
    level = np.zeros((side, side, 3), dtype=np.float32)
    for i in range(_RAYS):
        for j in range(_RAYS):
            at = [((np.arange(side) + (k + 0.5) / _RAYS) / side * 2.0 - 1.0) for k in (i, j)]
            u, v = np.meshgrid(at[1].astype(np.float32), at[0].astype(np.float32))
            level += np.moveaxis(radiance(unfolded(u, v)), 0, -1) / np.float32(_RAYS**2)
    levels = [_bordered(level)]
    while side > _COARSEST:
        side //= 2
        level = level.reshape(side, 2, side, 2, 3).mean(axis=(1, 3))
        levels.append(_bordered(level))
    sides = np.array([len(one) - 2 for one in levels], dtype=np.float32)
    tops = np.cumsum([0, *(len(one) for one in levels[:-1])]).astype(np.float32)
    atlas = np.zeros((sum(len(one) for one in levels), len(levels[0]), 3), dtype=np.float32)
    for top, one in zip(tops.astype(int), levels, strict=True):
        atlas[top : top + len(one), : len(one)] = one
    return Octahedra(atlas, tops, sides)


def _bordered(level: Array) -> Array:
    """A level, sharpened (1.5 minus an eighth of each neighbour), with its border."""
    around = _wrapped(level)
    near = around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:]
    return _wrapped(np.float32(1.5) * level - np.float32(0.125) * near)


def _wrapped(level: Array) -> Array:
    """Add a border of one texel: beyond an edge, the octahedron continues with it reversed."""
    wide = np.concatenate([level[::-1, :1], level, level[::-1, -1:]], axis=1)
    return np.concatenate([wide[:1, ::-1], wide, wide[-1:, ::-1]], axis=0)
