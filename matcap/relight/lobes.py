"""matcap.brdf's reflectance evaluated by the compiled loops: same formula and limits.

GGX from |n x h|^2 without cancellation, the height-correlated Smith visibility, Schlick's
Fresnel, float32. tests/relight/test_relight_lobes.py holds it to matcap.brdf.cook_torrance.
"""

from __future__ import annotations

from ctypes import c_int64

import numpy as np

from matcap.relight.loops.library import KeptArrays, Pointer, address, loops
from matcap.relight.vectors import Array, Vec

MIN_ROUGHNESS = 1e-3  # as matcap.brdf


def alpha_of(roughness: Array) -> Array:
    """GGX alpha of perceptual roughness."""
    return np.square(np.maximum(roughness, roughness.dtype.type(MIN_ROUGHNESS)))


def lobe(normal: Vec, to_view: Vec, to_light: Vec, alpha: Array) -> tuple[Array, Array]:
    """D G / (4 (n.l)(n.v)) in 1/sr, for cosines above 0, and Schlick's weight (1 - l.h)^5.

    Args:
        normal, to_view, to_light: unit vectors, (N,) each.
        alpha: positive.
    """
    kept, count = KeptArrays(), alpha.size
    values, weight = np.empty((2, count), dtype=np.float32)
    vectors = (Pointer(kept.of(np.stack(one))) for one in (normal, to_view, to_light))
    loops().matcap_relight_lobe(
        c_int64(count), *vectors, Pointer(kept.of(alpha)), address(values), address(weight)
    )
    return values, weight
