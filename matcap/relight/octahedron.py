"""Prefiltered environment maps in octahedral parametrisation, one for each lobe width.

A direction's place on the unfolded octahedron takes a few divisions (Engelhardt and Dachsbacher
2008), no angles. Each level is half as large as the one before; a lookup reads between four of its
texels. Averaging over texels and reading between them widens what is looked up by a quarter of a
texel's square along each axis, which blunts a smooth light's top; each level is sharpened by just
that, so that a lookup is exact for what is quadratic nearby and still misses no small sun.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from ctypes import byref, c_int64
from dataclasses import dataclass

import numpy as np

from matcap.relight.loops.library import KeptArrays, Pointer, address, loops
from matcap.relight.loops.structures import CSky
from matcap.relight.vectors import Array, Vec

_FINEST, _COARSEST = 1024, 4
# Rays a texel's side when the finest level is averaged.
_RAYS = 2

SkyPicture = Array


@dataclass(frozen=True)
class Octahedra:
    """The levels one above the other, each with a border that goes on around its edges."""

    atlas: SkyPicture
    """(h, w, 3) float32."""
    tops: Array
    """The row where each level begins, and."""
    sides: Array
    """How many texels it has along a side."""

    @property
    def finest(self) -> float:
        """Side of a texel of the finest level, in radians, on average."""
        return math.sqrt(4.0 * math.pi) / float(self.sides[0])

    def radiance(self, direction: Vec, wide: Array) -> SkyPicture:
        """(3, N) radiance along unit directions of the scene, averaged over `wide` radians.

        Args:
            direction: (N,) arrays.
            wide: (N,) square root of a solid angle.
        """
        kept, looked_up = KeptArrays(), np.empty((3, wide.size), dtype=np.float32)
        places = (Pointer(kept.of(one)) for one in (*direction, wide))
        loops().matcap_relight_radiance(
            byref(self.as_c(kept)), c_int64(wide.size), *places, address(looked_up)
        )
        return looked_up

    def as_c(self, kept: KeptArrays) -> CSky:
        """As a C structure (loops/structures.py)."""
        return CSky(
            kept.of(self.atlas), kept.of(self.tops), kept.of(self.sides),
            self.atlas.shape[1], len(self.sides), self.finest,
        )  # fmt: skip


def unfolded(u: Array, v: Array) -> Vec:
    """Unit directions of places on the unfolded octahedron."""
    z = 1.0 - np.abs(u) - np.abs(v)
    fold = np.maximum(-z, 0.0)
    x, y = u - np.copysign(fold, u), v - np.copysign(fold, v)
    inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
    return x * inverse, y * inverse, z * inverse


def octahedra(radiance: Callable[[Vec], SkyPicture], rows: int) -> Octahedra:
    """The octahedra of surroundings.

    Args:
        radiance: (3, ...) radiance along unit directions.
        rows: of the latitude-longitude picture behind it: the finest level is about as fine.
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


def _bordered(level: SkyPicture) -> SkyPicture:
    """A level sharpened, with a border."""
    around = _wrapped(level)
    near = around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:]
    return _wrapped(np.float32(1.5) * level - np.float32(0.125) * near)


def _wrapped(level: SkyPicture) -> SkyPicture:
    """One more texel around: across an edge lies the same edge, the other way round."""
    wide = np.concatenate([level[::-1, :1], level, level[::-1, -1:]], axis=1)
    return np.concatenate([wide[:1, ::-1], wide, wide[-1:, ::-1]], axis=0)
