"""Bounds of a scene that the plan decides from: extremes of maps, geometry and lights.

Everything here is a bound that holds for every point of the surface that the camera may see, and
costs a few passes over the maps at most. Nothing looks at pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from matcap.relight.camera import View
from matcap.relight.environment_map import Environment
from matcap.relight.lobes import alpha_of
from matcap.relight.scene import (
    DirectionalLight,
    EnvironmentLight,
    Light,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
)
from matcap.relight.texture import Texture
from matcap.relight.vectors import unit3

# The specular lobe reflects no more than this share, tables' rounding included.
WHOLE = 1.01


@dataclass(frozen=True)
class VisibleRegion:
    """Where visible points of the surface can be."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    """Corners of a box around them."""
    flat: bool
    """They lie on the plane z = 0 but for the relief."""

    def distances(self, place: Sequence[float]) -> tuple[float, float]:
        """Smallest and largest distance of any point of the box from a place."""
        nearest = farthest = 0.0
        for c, low, high in zip(place, self.low, self.high, strict=True):
            nearest += max(low - c, 0.0, c - high) ** 2
            farthest += max(abs(c - low), abs(c - high)) ** 2
        return math.sqrt(nearest), math.sqrt(farthest)

    def tangent(self, place: Sequence[float]) -> float:
        """Smallest tangent of a place's elevation above the plane, seen from any point."""
        if not self.flat:
            return 0.0
        across = math.hypot(
            *(max(abs(place[i] - self.low[i]), abs(place[i] - self.high[i])) for i in (0, 1))
        )
        return max(place[2] - self.high[2], 0.0) / max(across, 1e-12)


@dataclass(frozen=True)
class LightFacts:
    """One light as the surface meets it."""

    irradiance: float
    """At most, on a surface facing it, brightest channel."""
    tangent: float
    """Of its lowest elevation above the plane; 0 on curved surfaces."""
    varying: float
    """By how much at most the irradiance differs from that at the origin."""
    half_angle: float
    """Radians from its middle to its border, at most; 0 for points."""
    angle_cosine: float
    """Of half the angle between the directions to light and camera, at least."""


@dataclass(frozen=True)
class SceneBounds:
    """Everything the bounds are made of."""

    diffuse: float
    """Largest albedo."""
    specular: float
    """Largest F0."""
    alpha: tuple[float, float]
    """(smallest, largest) GGX alpha."""
    slope: float
    """Largest slope of the shading normals."""
    relief_slope: float
    """Largest slope of the displacing height; 0 without displacement."""
    relief: float
    """Highest minus lowest displacing height."""
    lights: tuple[LightFacts, ...]
    """All but environments."""
    sky: float
    """Largest radiance of the environments together."""
    sky_varying: float
    """By how much at most they differ from their mean."""
    footprint: float
    """Texels that a pixel covers, at most."""

    @property
    def lambert(self) -> float:
        """Largest diffuse reflectance in 1/sr."""
        return self.diffuse / math.pi

    def fresnel(self, light: LightFacts) -> float:
        """Largest Fresnel reflectance for a light."""
        weight = max(1.0 - light.angle_cosine, 0.0) ** 5
        return self.specular + (1.0 - self.specular) * weight

    def glossy(self, light: LightFacts) -> float:
        """Largest specular reflectance times n.l, in 1/sr: D <= 1/(pi a^2), V n.l <= 1/(2 a)."""
        return self.fresnel(light) / (2.0 * math.pi * self.alpha[0] ** 3)

    def radiance(self, light: LightFacts) -> float:
        """Largest radiance that a light can cause directly."""
        return light.irradiance * (self.lambert + self.glossy(light))

    @property
    def everything(self) -> float:
        """Largest radiance of the picture but for interreflection, lobes added up."""
        return sum(self.radiance(light) for light in self.lights) + self.surroundings

    @property
    def surroundings(self) -> float:
        """Largest radiance that the environments can cause."""
        return self.sky * (self.diffuse + WHOLE)


def gather(
    scene: Scene,
    texture: Texture,
    view: View,
    region: VisibleRegion,
    footprint: float,
    skies: Sequence[Environment],
) -> SceneBounds:
    """Bounds of the quantities of a scene.

    Args:
        scene: its lights and surface.
        texture: the material.
        view: the camera.
        region: where visible points can be.
        footprint: what a pixel covers on the material at most, in texels.
        skies: the scene's environments.
    """
    extremes = texture.extremes
    lights = tuple(
        _light_bounds(light, region, view)
        for light in scene.lights
        if not isinstance(light, EnvironmentLight)
    )
    lift = scene.surface.displacement
    low, high = (float(alpha_of(np.asarray(r, dtype=np.float32))) for r in extremes.roughness)
    if footprint > 1.0:
        # Filtering turns unresolved slopes into roughness.
        high = min(math.sqrt(high**2 + extremes.slope**2), 1.0)
    return SceneBounds(
        diffuse=extremes.diffuse,
        specular=extremes.specular,
        alpha=(low, high),
        slope=extremes.slope,
        relief_slope=extremes.relief_slope * lift,
        relief=extremes.relief * lift / scene.surface.repeat,
        lights=lights,
        sky=sum(sky.brightest for sky in skies),
        sky_varying=sum(sky.varying for sky in skies),
        footprint=footprint,
    )


def _light_bounds(
    light: PointLight | DirectionalLight | SphereLight | RectangleLight,
    region: VisibleRegion,
    view: View,
) -> LightFacts:
    if isinstance(light, DirectionalLight):
        direction = unit3(light.direction)
        across = math.hypot(direction[0], direction[1])
        tangent = max(float(direction[2]), 0.0) / max(across, 1e-12) if region.flat else 0.0
        return LightFacts(max(light.irradiance), tangent, 0.0, 0.0, 0.0)
    near, far = region.distances(light.position)
    intensity, half, tangent = _reach(light, near, region)
    central = float(np.linalg.norm(light.position))
    gap = max(near - half, 1e-9)
    received = intensity / gap**2
    varying = max(received - intensity / central**2 if central else math.inf, 0.0)
    varying = max(varying, intensity / max(central, 1e-9) ** 2 - intensity / far**2)
    angle = math.asin(min(half / max(near, 1e-12), 1.0))
    return LightFacts(received, tangent, varying, angle, _angle_cosine(light, near, region, view))


def _reach(
    light: PointLight | SphereLight | RectangleLight, near: float, region: VisibleRegion
) -> tuple[float, float, float]:
    """Largest radiant intensity, radius around the middle, and lowest elevation's tangent."""
    if isinstance(light, PointLight):
        return max(light.intensity), 0.0, region.tangent(light.position)
    x, y, z = light.position
    if isinstance(light, SphereLight):
        spot = math.pi * light.radius**2 * max(light.radiance)
        # A sphere seen from near by shows less than its cross-section, from inside anything.
        half = light.radius
    else:
        spot = light.size[0] * light.size[1] * max(light.radiance)
        half = math.hypot(*light.size) / 2.0
    rim = [(x + dx, y + dy, z - half) for dx in (-half, half) for dy in (-half, half)]
    return spot, half, min(region.tangent(place) for place in rim)


def _angle_cosine(light: Light, near: float, region: VisibleRegion, view: View) -> float:
    """Cosine of half the angle under which camera and light are seen, at least.

    In any triangle the side opposite to an angle g is at least the sum of the others times
    sin(g / 2).
    """
    if not view.perspective or not isinstance(light, PointLight):
        return 0.0
    baseline = math.dist(light.position, view.position)
    sides = near + region.distances(view.position.tolist())[0]
    sine = min(baseline / max(sides, 1e-12), 1.0)
    return math.sqrt(1.0 - sine * sine)
