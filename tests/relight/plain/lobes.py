"""The reflectance of matcap.brdf in NumPy, in whatever precision it is given."""

from __future__ import annotations

import math

import numpy as np

from matcap.relight.vectors import Array, Vec, add, dot

_TINY = 1e-7


def ggx_smith(
    normal: Vec, to_view: Vec, to_light: Vec, n_dot_v: Array, n_dot_l: Array, alpha: Array
) -> tuple[Array, Array]:
    """D G / (4 (n.l)(n.v)) in 1/sr for n.l, n.v > 0, and the cosine l.h that Fresnel wants.

    Args:
        normal, to_view, to_light: unit vectors.
        n_dot_v, n_dot_l: cosines, not negative.
        alpha: positive.
    """
    # In place where arrays have the block's full shape: less memory to go through.
    kind = alpha.dtype.type
    half = add(to_light, to_view)
    half_squared = np.maximum(dot(half, half), kind(1e-20))
    cosine = n_dot_l + n_dot_v
    # |n x h| is the length of what h has across n; no difference of large squares. Everything
    # times |l + v|^2, so that h need not be normalised.
    spread = np.zeros_like(cosine)
    for n, h in zip(normal, half, strict=True):
        across = cosine * n
        np.subtract(h, across, out=across)
        across *= across
        spread += across
    alpha_squared = alpha * alpha
    cosine *= cosine
    cosine *= alpha_squared
    spread += cosine
    d = np.divide(alpha * half_squared, spread, out=spread)
    rest = 1.0 - alpha_squared
    smith = _smith(n_dot_v, n_dot_l, rest, alpha_squared)
    smith += _smith(n_dot_l, n_dot_v, rest, alpha_squared)
    np.maximum(smith, kind(_TINY), out=smith)
    d *= d
    d *= kind(0.5 / math.pi)
    d /= smith
    # |l + v|^2 = 2 + 2 l.v = 4 (l.h)^2.
    return d, np.sqrt(half_squared) * kind(0.5)


def _smith(one: Array, other: Array, rest: Array, alpha_squared: Array) -> Array:
    """A cosine times Smith's root of the other."""
    root = one * one * rest
    root += alpha_squared
    np.sqrt(root, out=root)
    root *= other
    return root


def schlick_weight(l_dot_h: Array) -> Array:
    """(1 - l.h)^5, which mixes F0 and 1 (Schlick 1994, eq. 15)."""
    rest = np.maximum(1.0 - l_dot_h, l_dot_h.dtype.type(0.0))
    power = rest * rest
    power *= power
    power *= rest
    return power
