"""What a surface mirrors, plainly: what matcap.relight.loops is held to."""

from __future__ import annotations

import loop_calls
import numpy as np

from matcap.relight.environment_map import Environment
from matcap.relight.vectors import Array
from matcap.relight.visible_normals import lattice
from plain.visibility import HorizonTest
from plain.visible_normals import Lobe

_BLUR = np.float32(0.5)


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
        light = loop_calls.radiance(sky.octahedra, one.to_light, one.wide * _BLUR) * clear - mean
        light *= one.weight
        mixed = light * one.fresnel
        bias += mixed
        scale += light - mixed
    return scale, bias
