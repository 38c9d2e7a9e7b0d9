"""What a surface mirrors, plainly: what matcap.relight.loops is held to."""

from __future__ import annotations

import math

import numpy as np

from matcap.relight.environment_map import Environment
from matcap.relight.octahedron import Octahedra
from matcap.relight.vectors import Array, Vec
from matcap.relight.visible_normals import lattice
from plain.visibility import HorizonTest
from plain.visible_normals import Lobe

_BLUR = np.float32(0.5)


def radiance(octahedra: Octahedra, direction: Vec, wide: Array) -> Array:
    """(3, N) radiance along unit vectors, averaged over `wide` radians (root of a solid angle)."""
    x, y, z = direction
    u, v = np.stack([x, y]) / (np.abs(x) + np.abs(y) + np.abs(z))
    fold = z < 0.0
    u, v = (np.copysign(np.where(fold, 1.0 - np.abs(b), np.abs(a)), a) for a, b in ((u, v), (v, u)))
    level = np.floor(np.log2(wide * math.sqrt(2.0) / octahedra.finest)).astype(int)
    level = np.clip(level, 0, len(octahedra.sides) - 1)
    # Texel i is centred at i + 0.5, one further for the border.
    half = octahedra.sides[level] / 2.0
    column, row = (u + 1.0) * half + 0.5, (v + 1.0) * half + octahedra.tops[level] + 0.5
    left, above = column.astype(int), row.astype(int)
    fx, fy = (column - left)[:, None], (row - above)[:, None]
    four = [octahedra.atlas[above + j, left + i] for j in (0, 1) for i in (0, 1)]
    upper, lower = four[0] + fx * (four[1] - four[0]), four[2] + fx * (four[3] - four[2])
    return (upper + fy * (lower - upper)).T.astype(np.float32)


def hidden(lobe: Lobe, samples: int, horizon: HorizonTest | None) -> tuple[Array, Array]:
    """Share of even surroundings that surface and relief hide: times F0, and on its own."""
    scale, bias = (np.zeros(lobe.middle[2].shape, dtype=np.float32) for _ in range(2))
    for point in lattice(samples):
        one = lobe.mirrored(point)
        lost = ~one.above
        if horizon is not None:
            lost |= ~horizon(one.to_light)
        weight = one.weight * lost
        mixed = weight * one.fresnel
        bias += mixed
        scale += weight - mixed
    return scale, bias


def differing(
    sky: Environment, lobe: Lobe, samples: int, horizon: HorizonTest | None
) -> tuple[Array, Array]:
    """(3, ...) what is mirrored of surroundings beside their mean, likewise; on a plane."""
    mean = sky.mean.astype(np.float32)[:, None]
    scale, bias = np.zeros((2, 3, lobe.middle[2].size), dtype=np.float32)
    for point in lattice(samples):
        one = lobe.mirrored(point)
        clear = one.above if horizon is None else one.above & horizon(one.to_light)
        light = radiance(sky.octahedra, one.to_light, one.wide * _BLUR) * clear - mean
        light *= one.weight
        mixed = light * one.fresnel
        bias += mixed
        scale += light - mixed
    return scale, bias
