"""Scene bounds: extremes of maps, geometry and lights, from which effects compute their bounds.

Each holds for every point of the surface that the camera may see. All together cost a few passes
over the maps; no pixel is shaded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from matcap.relight.camera import View
from matcap.relight.environment_map import Environment
from matcap.relight.scene import (
    DirectionalLight,
    EnvironmentLight,
    Light,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
)
from matcap.relight.texture import Texture, alpha_of
from matcap.relight.vectors import unit3

# Upper bound of the specular lobe's directional albedo, with the error of the albedo tables.
LARGEST_ALBEDO = 1.01


@dataclass(frozen=True)
class VisibleRegion:
    """Axis-aligned box around all visible points of the surface, relief included."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    """Corners of the box, in plane units."""
    flat: bool
    """The undisplaced surface is the plane z = 0."""

    def distances(self, place: Sequence[float]) -> tuple[float, float]:
        """Smallest and largest distance between `place` and a point of the box."""
        nearest = farthest = 0.0
        for c, low, high in zip(place, self.low, self.high, strict=True):
            nearest += max(low - c, 0.0, c - high) ** 2
            farthest += max(abs(c - low), abs(c - high)) ** 2
        return math.sqrt(nearest), math.sqrt(farthest)

    def tangent(self, place: Sequence[float]) -> float:
        """Tangent of the lowest elevation at which a point of the box sees `place`.

        0 on curved surfaces, where any elevation occurs.
        """
        if not self.flat:
            return 0.0
        across = math.hypot(
            *(max(abs(place[i] - self.low[i]), abs(place[i] - self.high[i])) for i in (0, 1))
        )
        return max(place[2] - self.high[2], 0.0) / max(across, 1e-12)


@dataclass(frozen=True)
class LightBounds:
    """Extremes of one light over the visible region."""

    irradiance: float
    """Largest, on a surface facing the light, in its brightest channel."""
    tangent: float
    """Tangent of the lowest elevation above the plane; 0 on curved surfaces."""
    varying: float
    """Largest difference of the irradiance from that at the origin."""
    half_angle: float
    """Largest angular radius, radians; 0 for points."""
    angle_cosine: float
    """Smallest l.h: cosine of half the angle between light and view."""


@dataclass(frozen=True)
class SceneBounds:
    """Extremes of a scene, for the bounds of all effects."""

    diffuse: float
    """Largest diffuse albedo of any channel."""
    specular: float
    """Largest F0 of any channel."""
    alpha: tuple[float, float]
    """(smallest, largest) GGX alpha."""
    slope: float
    """Largest slope of the shading normals."""
    relief_slope: float
    """Largest slope of the displacing height; 0 without displacement."""
    relief: float
    """Highest minus lowest displacing height, in plane units."""
    lights: tuple[LightBounds, ...]
    """One for each light but environments."""
    environment: float
    """Largest radiance of the environments, added up."""
    environment_variation: float
    """Largest difference of an environment's radiance from its mean, added up."""
    footprint: float
    """Largest side of a pixel's footprint, in texels."""

    @property
    def lambert(self) -> float:
        """Largest diffuse BRDF, in 1/sr."""
        return self.diffuse / math.pi

    def fresnel(self, light: LightBounds) -> float:
        """Largest Fresnel reflectance for a light."""
        weight = max(1.0 - light.angle_cosine, 0.0) ** 5
        return self.specular + (1.0 - self.specular) * weight

    def glossy(self, light: LightBounds) -> float:
        """Largest specular BRDF times n.l, in 1/sr.

        F D V n.l with D <= 1 / (pi alpha^2) and V n.l <= 1 / (2 alpha), V = G / (4 (n.l)(n.v)).
        """
        return self.fresnel(light) / (2.0 * math.pi * self.alpha[0] ** 3)

    def radiance(self, light: LightBounds) -> float:
        """Largest radiance reflected directly from a light."""
        return light.irradiance * (self.lambert + self.glossy(light))

    @property
    def largest_radiance(self) -> float:
        """Largest radiance of the picture without interreflection."""
        return sum(self.radiance(light) for light in self.lights) + self.environment_radiance

    @property
    def environment_radiance(self) -> float:
        """Largest radiance reflected from the environments."""
        return self.environment * (self.diffuse + LARGEST_ALBEDO)


def gather(
    scene: Scene,
    texture: Texture,
    view: View,
    region: VisibleRegion,
    footprint: float,
    environments: Sequence[Environment],
) -> SceneBounds:
    """Compute the bounds of a scene.

    Args:
        footprint: largest side of a pixel's footprint, in texels.
        environments: one for each environment light.
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
        environment=sum(one.brightest for one in environments),
        environment_variation=sum(one.varying for one in environments),
        footprint=footprint,
    )


def _light_bounds(
    light: PointLight | DirectionalLight | SphereLight | RectangleLight,
    region: VisibleRegion,
    view: View,
) -> LightBounds:
    if isinstance(light, DirectionalLight):
        direction = unit3(light.direction)
        across = math.hypot(direction[0], direction[1])
        tangent = max(float(direction[2]), 0.0) / max(across, 1e-12) if region.flat else 0.0
        return LightBounds(max(light.irradiance), tangent, 0.0, 0.0, 0.0)
    near, far = region.distances(light.position)
    intensity, half, tangent = _extent(light, region)
    central = float(np.linalg.norm(light.position))
    gap = max(near - half, 1e-9)
    received = intensity / gap**2
    varying = max(received - intensity / central**2 if central else math.inf, 0.0)
    varying = max(varying, intensity / max(central, 1e-9) ** 2 - intensity / far**2)
    angle = math.asin(min(half / max(near, 1e-12), 1.0))
    return LightBounds(received, tangent, varying, angle, _angle_cosine(light, near, region, view))


def _extent(
    light: PointLight | SphereLight | RectangleLight, region: VisibleRegion
) -> tuple[float, float, float]:
    """Largest radiant intensity, bounding radius, and tangent of the lowest elevation."""
    if isinstance(light, PointLight):
        return max(light.intensity), 0.0, region.tangent(light.position)
    x, y, z = light.position
    if isinstance(light, SphereLight):
        spot = math.pi * light.radius**2 * max(light.radiance)
        # Nearby points see less than the sphere's cross-section.
        half = light.radius
    else:
        spot = light.size[0] * light.size[1] * max(light.radiance)
        half = math.hypot(*light.size) / 2.0
    rim = [(x + dx, y + dy, z - half) for dx in (-half, half) for dy in (-half, half)]
    return spot, half, min(region.tangent(place) for place in rim)


def _angle_cosine(light: Light, near: float, region: VisibleRegion, view: View) -> float:
    """Smallest cosine of half the angle between the directions to camera and light.

    In a triangle with sides a, b around an angle g, the third side is at least (a + b) sin(g / 2).
    """
    if not view.perspective or not isinstance(light, PointLight):
        return 0.0
    baseline = math.dist(light.position, view.position)
    sides = near + region.distances(view.position.tolist())[0]
    sine = min(baseline / max(sides, 1e-12), 1.0)
    return math.sqrt(1.0 - sine * sine)
