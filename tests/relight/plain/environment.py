"""What a surface mirrors, plainly: what matcap.relight.loops is held to."""

import loop_calls
import numpy as np

from matcap.relight.camera import Array, lattice
from matcap.relight.environment_map import Environment
from plain.visibility import above_horizon
from plain.visible_normals import Lobe, Mirrored

_BLUR = np.float32(0.5)


def hidden(lobe: Lobe, samples: int, tangents: Array | None) -> Array:
    """Share of even surroundings that surface and relief hide: (2, N), times F0 and on its own.

    tangents: (N, AZIMUTHS) horizons of the pixels, or None.
    """
    shares = np.zeros((2, lobe.n_dot_v.size), dtype=np.float32)
    for point in lattice(samples):
        one = lobe.mirrored(point)
        weight = one.weight * ~_clear(one, tangents)
        shares += weight * (1.0 - one.fresnel), weight * one.fresnel
    return shares


def differing(sky: Environment, lobe: Lobe, samples: int, tangents: Array | None) -> Array:
    """(2, 3, N) what is mirrored of surroundings beside their mean, likewise; on a plane."""
    mean = sky.mean.astype(np.float32)[:, None]
    shares = np.zeros((2, 3, lobe.n_dot_v.size), dtype=np.float32)
    for point in lattice(samples):
        one = lobe.mirrored(point)
        light = loop_calls.radiance(sky.octahedra, one.to_light, one.wide * _BLUR)
        light = (light * _clear(one, tangents) - mean) * one.weight
        shares += light * (1.0 - one.fresnel), light * one.fresnel
    return shares


def _clear(one: Mirrored, tangents: Array | None) -> Array:
    """Whether directions are above the undisplaced surface and the relief."""
    above = one.to_light[2] > 0.0
    return above if tangents is None else above & above_horizon(tangents, one.to_light)
