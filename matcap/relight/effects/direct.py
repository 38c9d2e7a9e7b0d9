"""Direct light: diffuse and specular lobe, and falloff with distance.

- `diffuse`: albedo / pi [lambert1760]. Left out: no diffuse reflection. Cost: three multiplications
  a light and pixel.
- `specular`: D G F / (4 (n.l)(n.v)), D GGX [walter2007, eq. 33], G [heitz2014, eq. 99], F
  [schlick1994, eq. 15]. Left out: no specular reflection. Cost: about fifty operations a light and
  pixel.
- `falloff`: irradiance = intensity / distance^2 [lambert1760]. Left out: the irradiance at the
  origin everywhere, with each point's own direction. Cost: one division a light and pixel.
"""

from __future__ import annotations

import math
from ctypes import byref

import numpy as np

from matcap.relight.block import Block
from matcap.relight.camera import Array, unit3
from matcap.relight.effects import Bound
from matcap.relight.loops.library import (
    DIFFUSE,
    LOST,
    SPECULAR,
    VECTOR,
    CHorizon,
    CLamp,
    address,
    loops,
)
from matcap.relight.plan import LARGEST_ALBEDO, SceneBounds
from matcap.relight.scene import DirectionalLight, PointLight, RectangleLight, SphereLight


def diffuse_bound(limits: SceneBounds) -> Bound:
    """Largest albedo / pi times the irradiance of all lights, with the environments'."""
    light = sum(light.irradiance for light in limits.lights)
    if limits.diffuse == 0.0:
        return Bound(0.0, "the diffuse albedo is 0 everywhere")
    if light == 0.0 and limits.environment == 0.0:
        return Bound(0.0, "there is no light")
    return Bound(
        limits.lambert * light + limits.diffuse * limits.environment,
        f"albedo up to {limits.diffuse:.2g}",
    )


def specular_bound(limits: SceneBounds) -> Bound:
    """Irradiance of each light times its SceneBounds.glossy, plus the environments' radiance."""
    direct = sum(light.irradiance * limits.glossy(light) for light in limits.lights)
    total = direct + limits.environment * LARGEST_ALBEDO
    if total == 0.0:
        return Bound(0.0, "there is no light to reflect")
    return Bound(total, f"F0 up to {limits.specular:.2g}, alpha down to {limits.alpha[0]:.2g}")


def falloff_bound(limits: SceneBounds) -> Bound:
    """Largest difference of irradiance from that at the origin, times the largest BRDF n.l."""
    if not any(light.varying for light in limits.lights):
        return Bound(0.0, "no light is near enough to fall off")
    total = sum(
        light.varying * (limits.lambert + limits.glossy(light)) if light.varying else 0.0
        for light in limits.lights
    )
    share = max(light.varying / max(light.irradiance, 1e-30) for light in limits.lights)
    return Bound(total, f"distances differ: up to {100 * share:.2g} % of the light")


def add(block: Block, light: PointLight | DirectionalLight | SphereLight | RectangleLight) -> None:
    """Add a light as a point light; an area light as one in its middle."""
    plan, lit = block.plan, None
    lamp = _lamp(light, falls=plan.on("falloff"))
    lamp.parts = (
        DIFFUSE * plan.on("diffuse")
        + SPECULAR * plan.on("specular")
        + LOST * plan.on("multiscatter")
        + VECTOR * plan.on("interreflection")
    )
    if plan.on("shadows"):
        with block.context.tally.timed("shadows"):
            lit = np.ones(block.tiles.size, dtype=np.float32)
            cast = np.zeros(block.tiles.size, dtype=np.uint8)
            loops().matcap_relight_past(
                byref(block.as_c), byref(lamp), byref(block.context.relief.field), None,
                address(lit), address(cast),
            )  # fmt: skip
            block.ran("shadows", cast > 0)
    add_lamp(block, lamp, lit)


def add_lamp(block: Block, lamp: CLamp, lit: Array | None) -> None:
    """Add a point light. One loop adds all its terms; its time counts as the costliest's.

    Args:
        lit: (N,) share of the light that arrives, [0, 1]; None is 1.
    """
    with block.context.tally.timed("specular" if block.plan.on("specular") else "diffuse"):
        arrives = None if lit is None else address(lit)
        loops().matcap_relight_lamp(byref(block.as_c), byref(lamp), arrives)


def sun(direction: tuple[float, float, float], irradiance: tuple[float, float, float]) -> CLamp:
    """A sun of an environment as a directional light with the specular term alone."""
    return CLamp(place=direction, colour=irradiance, far=1, power=1.0, parts=SPECULAR)


def above_horizon(block: Block, lamp: CLamp, horizon: CHorizon) -> Array:
    """(N,) 1 where a light is above the horizon map, else 0."""
    lit = np.ones(block.tiles.size, dtype=np.float32)
    loops().matcap_relight_past(
        byref(block.as_c), byref(lamp), None, byref(horizon), address(lit), None
    )
    return lit


def _lamp(
    light: PointLight | DirectionalLight | SphereLight | RectangleLight, *, falls: bool
) -> CLamp:
    if isinstance(light, DirectionalLight):
        return CLamp(place=tuple(unit3(light.direction)), colour=light.irradiance, far=1, power=1.0)
    central = max(sum(c * c for c in light.position), 1e-12)
    lamp = CLamp(place=light.position, power=1.0, even=0.0 if falls else 1.0 / central)
    if isinstance(light, PointLight):
        lamp.colour = light.intensity
        return lamp
    lamp.colour = light.radiance
    if isinstance(light, RectangleLight):
        lamp.normal, lamp.faces = tuple(unit3(light.normal)), 1
        lamp.power = light.size[0] * light.size[1]
    else:
        lamp.power = math.pi * light.radius**2
    return lamp
