"""Directions in which a rough surface mirrors a view: the visible normals of GGX.

Spherical caps (Dupuy and Benyoub 2023) sample the normals that a view sees; light from the
mirrored direction counts F G2 / G1. The same points for every pixel, a lattice of low discrepancy
(R2, Roberts 2018): no noise, and pictures of twice the light are twice as bright to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from matcap.relight.lobes import schlick_weight
from matcap.relight.sampling import Sample
from matcap.relight.vectors import Array, Vec, add, dot, scale

_R2 = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True)
class Mirrored:
    """One direction for each pixel of a block.

    Attributes:
        to_light: unit vector in the material's frame.
        weight: G2 / G1; 0 for directions below the shading normal's horizon.
        fresnel: (1 - l.h)^5.
        density: of the direction, per sr.
    """

    to_light: Vec
    weight: Array
    fresnel: Array
    density: Array


def mirrored(sample: Sample, to_view: Vec, n_dot_v: Array, count: int) -> Iterator[Mirrored]:
    """`count` directions of each pixel; the mean of weight times Fresnel times light is radiance.

    Args:
        sample: the material; only normal and alpha matter.
        to_view: unit vectors in the material's frame.
        n_dot_v: their cosines with the normal; pixels without a positive one get weight 0.
        count: how many.
    """
    normal, alpha = sample.normal, sample.alpha
    tangent, bitangent = basis(normal)
    n_dot_v = np.maximum(n_dot_v, np.float32(1e-4))
    vx, vy = dot(to_view, tangent) * alpha, dot(to_view, bitangent) * alpha
    inverse = 1.0 / np.sqrt(vx * vx + vy * vy + n_dot_v * n_dot_v)
    vx, vy, vz = vx * inverse, vy * inverse, n_dot_v * inverse
    alpha_squared = alpha * alpha
    rest = 1.0 - alpha_squared
    view_term = np.sqrt(alpha_squared + rest * n_dot_v * n_dot_v)
    g1 = 2.0 * n_dot_v / (n_dot_v + view_term)
    for index in range(count):
        u = (0.5 + _R2[0] * index) % 1.0
        angle = 2.0 * math.pi * ((0.5 + _R2[1] * index) % 1.0)
        z = np.float32(1.0 - u) * (1.0 + vz) - vz
        ring = np.sqrt(np.maximum(1.0 - z * z, np.float32(0.0)))
        hx = (ring * np.float32(math.cos(angle)) + vx) * alpha
        hy = (ring * np.float32(math.sin(angle)) + vy) * alpha
        hz = np.maximum(z + vz, np.float32(1e-9))
        inverse = 1.0 / np.sqrt(hx * hx + hy * hy + hz * hz)
        hx, hy, hz = hx * inverse, hy * inverse, hz * inverse
        half = add(add(scale(tangent, hx), scale(bitangent, hy)), scale(normal, hz))
        cosine = np.maximum(dot(to_view, half), np.float32(0.0))
        to_light = tuple(2.0 * cosine * half[i] - to_view[i] for i in range(3))
        n_dot_l = 2.0 * cosine * hz - n_dot_v
        shining = n_dot_l > 0.0
        n_dot_l = np.maximum(n_dot_l, np.float32(1e-6))
        light_term = np.sqrt(alpha_squared + rest * n_dot_l * n_dot_l)
        ratio = n_dot_l * (n_dot_v + view_term) / (n_dot_l * view_term + n_dot_v * light_term)
        spread = (hx * hx + hy * hy) + hz * hz * alpha_squared
        d = (alpha / spread) ** 2 * np.float32(1.0 / math.pi)
        yield Mirrored(
            to_light,  # type: ignore[arg-type]
            np.where(shining, ratio, np.float32(0.0)),
            schlick_weight(cosine),
            g1 * d / (4.0 * n_dot_v),
        )


def basis(normal: Vec) -> tuple[Vec, Vec]:
    """Two unit vectors that complete unit normals (Duff et al. 2017)."""
    x, y, z = normal
    sign = np.copysign(np.float32(1.0), z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)
