"""The GGX specular lobe D G F / (4 (n.l)(n.v)), see matcap.relight.lobes.

GGX: Walter et al. 2007, eq. 33; G: Heitz 2014, eq. 99; F: Schlick 1994, eq. 15.

Left out: no specular reflection at all. Cost: about fifty operations a light and pixel.
"""

from __future__ import annotations

from matcap.relight.effects import environment
from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts


def bound(facts: Facts) -> Bound:
    """D <= 1 / (pi alpha^2), V n.l <= 1 / (2 alpha), F from the angle between light and view."""
    direct = sum(light.irradiance * facts.glossy(light) for light in facts.lights)
    total = direct + environment.mirrored_bound(facts)
    if total == 0.0:
        return Bound(0.0, "there is no light to reflect")
    return Bound(total, f"F0 up to {facts.specular:.2g}, alpha down to {facts.alpha[0]:.2g}")
