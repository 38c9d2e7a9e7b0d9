"""Scene bounds, the plan of a picture (which effects run), and the record of what ran."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from threading import Lock
from time import perf_counter
from typing import Any

import numpy as np

from matcap.files.color import srgb_encode, srgb_slope
from matcap.relight.camera import Array, View, unit3
from matcap.relight.environment_map import Environment
from matcap.relight.scene import (
    DirectionalLight,
    EnvironmentLight,
    Film,
    Light,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
)
from matcap.relight.texture import Texture, alpha_of

# Record of a picture's rendering: the tiles in which each effect ran, and the seconds it took.

TILE = 32  # pixels a side


@dataclass(frozen=True)
class Tally:
    """Tiles and wall-clock seconds by effect, filled during rendering; threads may share one."""

    size: tuple[int, int]
    """(width, height) of the picture in pixels."""
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    """Summed over threads."""
    _ran: dict[str, Array] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    @contextmanager
    def timed(self, effect: str) -> Iterator[None]:
        """Add the time spent inside the `with` block to an effect's seconds."""
        start = perf_counter()
        yield
        spent = perf_counter() - start
        with self._lock:
            self.seconds[effect] += spent

    @property
    def tiles(self) -> tuple[int, int]:
        """Number of tiles across and down."""
        return -(-self.size[0] // TILE), -(-self.size[1] // TILE)

    def of(self, top: int, bottom: int, left: int, right: int) -> Array:
        """(rows, columns) index of the tile of each pixel of a rectangle."""
        row, column = np.arange(top, bottom) // TILE, np.arange(left, right) // TILE
        return row[:, None] * self.tiles[0] + column

    def ran(self, effect: str, tiles: Array) -> None:
        """Record an effect in tiles, given by index."""
        across, down = self.tiles
        self._ran.setdefault(effect, np.zeros(across * down, dtype=bool))[tiles] = True

    def shares(self) -> Mapping[str, float]:
        """Share of all tiles, in [0, 1], in which each effect ran."""
        return {effect: float(ran.mean()) for effect, ran in self._ran.items()}


# Scene bounds: extremes of maps, geometry and lights, from which effects compute their bounds.
#
# Each holds for every point of the surface that the camera may see. All together cost a few passes
# over the maps; no pixel is shaded.

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


# The plan of a picture: which effects run, and the bound on what leaving each out could change.


@dataclass(frozen=True)
class Step:
    """One effect's entry in the plan."""

    effect: str
    on: bool
    """Whether it runs."""
    bound: float
    """Largest change of radiance, in any channel of any pixel, from leaving it out."""
    reason: str
    """Why it runs or not."""
    milliseconds: float = 0.0
    """Time it took, summed over cores; 0 before rendering."""
    spends: bool = True
    """Whether, when off, its bound counts against the tolerance: not where the user switched it."""
    share: float | None = None
    """Share of the picture's tiles in which it ran, in [0, 1]; None before rendering."""


@dataclass(frozen=True)
class Plan:
    """All effects, and the tolerance in radiance within which some are left out."""

    steps: tuple[Step, ...]
    tolerance: float
    running: frozenset[str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "running", frozenset(s.effect for s in self.steps if s.on))

    def on(self, effect: str) -> bool:
        """Whether an effect runs."""
        return effect in self.running

    def left(self, tolerance: float, film: Film) -> float:
        """Remaining tolerance, in code values, after the effects left out by their bounds.

        Effects that the user switched off count nothing.
        """
        spent = sum(step.bound for step in self.steps if not step.on and step.spends)
        light = np.array(min(spent, self.tolerance) * film.gain)
        code = light if film.transfer == "linear" else srgb_encode(light)
        return max(tolerance - float(code), 0.0)

    def done(self, seconds: Mapping[str, float], shares: Mapping[str, float]) -> Plan:
        """The plan with measured seconds, and the share of tiles in which each effect ran."""
        steps = tuple(
            replace(
                step,
                milliseconds=1e3 * seconds.get(step.effect, 0.0),
                share=shares.get(step.effect, 0.0) if step.on else 0.0,
            )
            for step in self.steps
        )
        return Plan(steps, self.tolerance)

    def table(self) -> str:
        """The plan as text: effect, on or off, share of tiles, bound, milliseconds, reason."""
        lines = [f"{'effect':<16}{'':<5}{'tiles':>6}{'bound':>9}{'ms':>10}  reason"]
        for step in self.steps:
            state = "on" if step.on else "off"
            share = "-" if step.share is None else f"{100.0 * step.share:.0f} %"
            lines.append(
                f"{step.effect:<16}{state:<5}{share:>6}{step.bound:>9.2g}"
                f"{step.milliseconds:>10.1f}  {step.reason}"
            )
        lines.append(f"tolerance {self.tolerance:.2g} in radiance; milliseconds of all cores")
        return "\n".join(lines)

    def rows(self) -> list[dict[str, Any]]:
        """One dictionary a step, for JSON; infinite bounds are None."""
        return [
            {
                "effect": step.effect,
                "on": step.on,
                "bound": step.bound if math.isfinite(step.bound) else None,
                "reason": step.reason,
                "tiles": step.share,
                "milliseconds": round(step.milliseconds, 3),
            }
            for step in self.steps
        ]


# Shares of the budget. That of area lights is the measured error of their quadrature. Hardly a
# pixel mirrors so little of an environment that a larger share would let it leave that out.
SHARES: Mapping[str, float] = {"area": 0.4, "environment": 0.05, "interreflection": 0.55}


@dataclass(frozen=True)
class Budget:
    """Error that each pixel may have: the tolerance that the plan has left, in code values.

    Radiance only adds up, so the radiance L of a pixel so far is a lower bound of the final one.
    The sRGB curve f is concave: a change d anywhere above L changes the code by no more than
    f'(L) d. A pixel may thus lose tolerance / f'(L), eight times as much at code 0.5 as at black.
    """

    codes: float
    """Tolerance left, in code values, [0, 1]."""
    film: Film
    """Exposure and transfer of the picture."""
    running: frozenset[str]
    """Names of the effects that run."""

    def radiance(self, effect: str, known: Array) -> Array:
        """(3, ...) radiance that leaving an effect out may change.

        Args:
            effect: a name in SHARES.
            known: (3, ...) radiance of the pixels so far.
        """
        share = SHARES[effect] / sum(SHARES[one] for one in {effect, *self.running} & set(SHARES))
        allowed = np.float32(share * self.codes / self.film.gain)
        if self.film.transfer == "linear":
            return np.broadcast_to(allowed, known.shape)
        return allowed / srgb_slope(known * np.float32(self.film.gain))
