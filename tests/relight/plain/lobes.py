"""The reflectance of matcap.brdf in NumPy, in whatever precision it is given."""

import math

import numpy as np

from matcap.relight.camera import Array, Vec, add, dot, scale, subtract


def ggx_smith(
    normal: Vec, to_view: Vec, to_light: Vec, n_dot_v: Array, n_dot_l: Array, alpha: Array
) -> tuple[Array, Array]:
    """D G / (4 (n.l)(n.v)) in 1/sr for n.l, n.v > 0, and the cosine l.h that Fresnel wants.

    Args:
        normal, to_view, to_light: unit vectors.
        n_dot_v, n_dot_l: cosines, not negative.
        alpha: positive.
    """
    half = add(to_light, to_view)
    half_squared = np.maximum(dot(half, half), 1e-20)  # |l + v|^2 = 4 (l.h)^2
    cosine, squared = n_dot_l + n_dot_v, alpha * alpha
    # |n x h| is the length of what h has across n; no difference of large squares. Everything
    # times |l + v|^2, so that h need not be normalised.
    across = subtract(half, scale(normal, cosine))
    d = alpha * half_squared / (dot(across, across) + cosine * cosine * squared)

    def smith(one: Array, other: Array) -> Array:
        return one * np.sqrt(other * other * (1.0 - squared) + squared)

    masked = np.maximum(smith(n_dot_l, n_dot_v) + smith(n_dot_v, n_dot_l), 1e-7)
    return d * d * (0.5 / math.pi) / masked, np.sqrt(half_squared) * 0.5


def schlick_weight(l_dot_h: Array) -> Array:
    """(1 - l.h)^5, which mixes F0 and 1 (Schlick 1994, eq. 15)."""
    return np.maximum(1.0 - l_dot_h, 0.0) ** 5
