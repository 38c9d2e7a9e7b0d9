"""Light that bounces between microfacets before it leaves: the energy a single bounce loses.

f_ms = Fms (1 - E(n.l)) (1 - E(n.v)) / (pi (1 - Eavg)), with Fms = Favg^2 Eavg /
(1 - Favg (1 - Eavg)) and Favg = F0 + (1 - F0) / 21 for Schlick (Kulla and Conty 2017, with the
tables of matcap.relight.tables). Reciprocal; a white metal reflects all it receives.

Left out: rough metals lose up to half their light. Cost: two small table lookups a light and
pixel. It is additional to the reflectance that captures are fitted with
(brdf/cook_torrance.py), whose F0 of 0.04 makes it too small to see on anything but metal.
"""

from __future__ import annotations

import math

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.scene_bounds import SceneBounds
from matcap.relight.tables import albedo
from matcap.relight.vectors import Array


def bound(limits: SceneBounds) -> Bound:
    """The lobe's largest value for the roughnesses there are, under all the light there is."""
    light = sum(light.irradiance for light in limits.lights)
    if light == 0.0 and limits.sky == 0.0:
        return Bound(0.0, "there is no light")
    tables = albedo()
    rows = np.linspace(0.0, 1.0, len(tables.average)) ** 2
    # One row more on either side, because lookups interpolate.
    first = max(int(np.searchsorted(rows, limits.alpha[0], side="right")) - 1, 0)
    last = min(int(np.searchsorted(rows, limits.alpha[1])), len(rows) - 1)
    missing = 1.0 - tables.total[first : last + 1].min(axis=1)
    mean = tables.average[first : last + 1]
    strength = _strength(np.float32(limits.specular), mean)
    lobe = float((strength * missing**2 / np.maximum(1.0 - mean, 1e-6)).max())
    share = float((strength * missing).max())
    reason = f"F0 up to {limits.specular:.2g}, alpha up to {limits.alpha[1]:.2g}"
    # n.l <= 1 bounds the cosine; an environment sees the lobe's albedo.
    return Bound(1.02 * (lobe / math.pi * light + share * limits.sky), reason)


def terms(specular: Array, near: Array, n_dot_v: Array) -> tuple[Array, Array]:
    """What a pixel needs for all its lights.

    Args:
        specular: F0.
        near: Albedo.near() of its alpha.
        n_dot_v: cosine, not negative.

    Returns:
        Fms (1 - E(n.v)) / (pi (1 - Eavg)), which (1 - E(n.l)) n.l is multiplied by; and
        Fms (1 - E(n.v)), the albedo of the lobe.
    """
    tables = albedo()
    mean = tables.average_at(near)
    share = _strength(specular, mean) * tables.missing(near, n_dot_v)
    return share / (np.maximum(1.0 - mean, np.float32(1e-6)) * np.float32(math.pi)), share


def _strength(specular: Array | np.float32, mean: Array) -> Array:
    """Fms of F0 and Eavg."""
    fresnel = specular + (1.0 - specular) * np.float32(1.0 / 21.0)
    strength: Array = fresnel * fresnel * mean / (1.0 - fresnel * (1.0 - mean))
    return strength
