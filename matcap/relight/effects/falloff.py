"""Distance falloff: irradiance is intensity over distance squared (Lambert 1760).

Left out: every point receives what the scene's origin would; directions stay each point's own.
Cost: one division a light and pixel.
"""

from __future__ import annotations

from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts


def bound(facts: Facts) -> Bound:
    """The largest difference of irradiance from that at the origin, times the reflectance."""
    if not any(light.varying for light in facts.lights):
        return Bound(0.0, "no light is near enough to fall off")
    total = sum(
        light.varying * (facts.lambert + facts.glossy(light)) if light.varying else 0.0
        for light in facts.lights
    )
    share = max(light.varying / max(light.irradiance, 1e-30) for light in facts.lights)
    return Bound(total, f"distances differ: up to {100 * share:.2g} % of the light")
