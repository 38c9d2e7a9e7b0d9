"""The diffuse lobe: albedo / pi (Lambert 1760).

Left out: no diffuse reflection at all. Cost: three multiplications a light and pixel.
"""

from __future__ import annotations

from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts


def bound(facts: Facts) -> Bound:
    """Largest albedo under all the light there is."""
    light = sum(light.irradiance for light in facts.lights)
    if facts.diffuse == 0.0:
        return Bound(0.0, "the diffuse albedo is 0 everywhere")
    if light == 0.0 and facts.sky == 0.0:
        return Bound(0.0, "there is no light")
    return Bound(
        facts.lambert * light + facts.diffuse * facts.sky, f"albedo up to {facts.diffuse:.2g}"
    )
