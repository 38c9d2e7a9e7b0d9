"""Multiple scattering between microfacets: the energy that a single bounce loses [kulla2017].

f_ms = Fms (1 - E(n.l)) (1 - E(n.v)) / (pi (1 - Eavg)), Fms = Favg^2 Eavg / (1 - Favg (1 - Eavg)),
Favg = F0 + (1 - F0) / 21 for Schlick's Fresnel; E and Eavg are tables
(matcap.relight.environment_map).
Reciprocal; with F0 = 1 all energy is reflected.

Left out: rough metals lose up to half their light. Cost: two table lookups a light and pixel.
Captures are fitted without it (brdf/cook_torrance.py): with the F0 of dielectrics, 0.04, it is too
small to see.
"""

from __future__ import annotations

import math

import numpy as np

from matcap.relight.camera import Array
from matcap.relight.effects import Bound
from matcap.relight.environment_map import albedo
from matcap.relight.plan import SceneBounds


def bound(limits: SceneBounds) -> Bound:
    """Largest f_ms n.l for the scene's roughnesses, times the irradiance of all lights."""
    light = sum(light.irradiance for light in limits.lights)
    if light == 0.0 and limits.environment == 0.0:
        return Bound(0.0, "there is no light")
    tables = albedo()
    rows = np.linspace(0.0, 1.0, len(tables.average)) ** 2
    # One more row on either side: lookups interpolate.
    first = max(int(np.searchsorted(rows, limits.alpha[0], side="right")) - 1, 0)
    last = min(int(np.searchsorted(rows, limits.alpha[1])), len(rows) - 1)
    missing = 1.0 - tables.total[first : last + 1].min(axis=1)
    mean = tables.average[first : last + 1]
    strength = _strength(np.float32(limits.specular), mean)
    lobe = float((strength * missing**2 / np.maximum(1.0 - mean, 1e-6)).max())
    share = float((strength * missing).max())
    reason = f"F0 up to {limits.specular:.2g}, alpha up to {limits.alpha[1]:.2g}"
    # n.l <= 1; an environment's radiance counts times the lobe's albedo.
    return Bound(1.02 * (lobe / math.pi * light + share * limits.environment), reason)


def terms(specular: Array, near: Array, n_dot_v: Array) -> tuple[Array, Array]:
    """Factors of the lobe that do not depend on the light.

    Args:
        specular: F0.
        near: Albedo.near(alpha).
        n_dot_v: clamped to 0.

    Returns:
        Fms (1 - E(n.v)) / (pi (1 - Eavg)), the factor of (1 - E(n.l)) n.l; and Fms (1 - E(n.v)),
        the lobe's albedo.
    """
    tables = albedo()
    mean = tables.average_at(near)
    share = _strength(specular, mean) * tables.missing(near, n_dot_v)
    return share / (np.maximum(1.0 - mean, np.float32(1e-6)) * np.float32(math.pi)), share


def _strength(specular: Array | np.float32, mean: Array) -> Array:
    """Fms of F0 and Eavg."""
    fresnel = specular + (1.0 - specular) * np.float32(1.0 / 21.0)
    return fresnel * fresnel * mean / (1.0 - fresnel * (1.0 - mean))
