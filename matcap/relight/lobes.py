"""Roughness of the specular lobe.

The lobe itself is ggx() in loops/loops.h, matcap.brdf's reflectance in float32: GGX [walter2007]
from |n x h|^2 without cancellation, height-correlated Smith [heitz2014], Schlick's Fresnel
[schlick1994].
"""

from __future__ import annotations

import numpy as np

from matcap.relight.vectors import Array

MIN_ROUGHNESS = 1e-3  # as matcap.brdf


def alpha_of(roughness: Array) -> Array:
    """GGX alpha of perceptual roughness: its square, at least 1e-6."""
    return np.square(np.maximum(roughness, roughness.dtype.type(MIN_ROUGHNESS)))
