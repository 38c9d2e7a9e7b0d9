"""Light straight from its source: the two lobes, and falloff with distance.

- `diffuse`: albedo / pi (Lambert 1760). Left out: no diffuse reflection at all. Cost: three
  multiplications a light and pixel.
- `specular`: the GGX lobe D G F / (4 (n.l)(n.v)) of matcap.relight.lobes (GGX: Walter et al. 2007,
  eq. 33; G: Heitz 2014, eq. 99; F: Schlick 1994, eq. 15). Left out: no specular reflection at all.
  Cost: about fifty operations a light and pixel.
- `falloff`: irradiance is intensity over distance squared (Lambert 1760). Left out: every point
  receives what the scene's origin would; directions stay each point's own. Cost: one division a
  light and pixel.
"""

from __future__ import annotations

from matcap.relight.effects import environment
from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts


def diffuse_bound(facts: Facts) -> Bound:
    """Largest albedo under all the light there is."""
    light = sum(light.irradiance for light in facts.lights)
    if facts.diffuse == 0.0:
        return Bound(0.0, "the diffuse albedo is 0 everywhere")
    if light == 0.0 and facts.sky == 0.0:
        return Bound(0.0, "there is no light")
    return Bound(
        facts.lambert * light + facts.diffuse * facts.sky, f"albedo up to {facts.diffuse:.2g}"
    )


def specular_bound(facts: Facts) -> Bound:
    """D <= 1 / (pi alpha^2), V n.l <= 1 / (2 alpha), F from the angle between light and view."""
    direct = sum(light.irradiance * facts.glossy(light) for light in facts.lights)
    total = direct + environment.mirrored_bound(facts)
    if total == 0.0:
        return Bound(0.0, "there is no light to reflect")
    return Bound(total, f"F0 up to {facts.specular:.2g}, alpha down to {facts.alpha[0]:.2g}")


def falloff_bound(facts: Facts) -> Bound:
    """The largest difference of irradiance from that at the origin, times the reflectance."""
    if not any(light.varying for light in facts.lights):
        return Bound(0.0, "no light is near enough to fall off")
    total = sum(
        light.varying * (facts.lambert + facts.glossy(light)) if light.varying else 0.0
        for light in facts.lights
    )
    share = max(light.varying / max(light.irradiance, 1e-30) for light in facts.lights)
    return Bound(total, f"distances differ: up to {100 * share:.2g} % of the light")
