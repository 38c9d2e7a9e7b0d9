"""Radiance of a block of pixels: every light through every effect that the plan runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from matcap.relight.clock import Clock
from matcap.relight.effects import (
    area,
    environment,
    interreflection,
    multiscatter,
    parallax,
    shadows,
    visibility,
)
from matcap.relight.environment_map import Environment
from matcap.relight.horizons import Horizons
from matcap.relight.lobes import ggx_smith, schlick_weight
from matcap.relight.plan import Plan
from matcap.relight.relief import Relief
from matcap.relight.sampling import Sampler, SurfaceSample
from matcap.relight.scene import (
    Colour,
    DirectionalLight,
    EnvironmentLight,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
)
from matcap.relight.surfaces.hits import Hits, to_frame, to_scene
from matcap.relight.tables import albedo
from matcap.relight.vectors import Array, Vec, add, dot, scale, subtract, unit3, vec
from matcap.relight.visible_normals import lattice, lobe_of

_ZERO: Any = np.float32(0.0)
_ONE: Any = np.float32(1.0)
# Plane units squared, from a point light: nearer, it would be in the surface.
_NEAREST: Any = np.float32(1e-12)


@dataclass(frozen=True)
class ShadingContext:
    """What all blocks of a picture share.

    Attributes:
        scene: lights and surface.
        sampler: the material on the surface.
        relief: its height.
        plan: which effects run.
        skies: the environments, in the order of their lights.
        horizons: where ambient visibility or interreflection run.
        clock: of the effects.
        samples: directions in which surroundings are mirrored.
    """

    scene: Scene
    sampler: Sampler
    relief: Relief
    plan: Plan
    skies: tuple[Environment, ...]
    horizons: Horizons | None
    clock: Clock
    samples: int


def shade(context: ShadingContext, hits: Hits) -> Array:
    """(3, rows, W) radiance of a block; 0 where nothing is seen."""
    height: Array = np.zeros((1, 1), dtype=np.float32)
    if context.plan.on("parallax"):
        with context.clock.on("parallax"):
            hits, height = _displaced(context.relief, hits)
    elif context.plan.on("shadows"):
        height = context.relief.at(*hits.place)
    with context.clock.on("filtering" if context.plan.on("filtering") else "reading"):
        footprint = hits.footprint if context.plan.on("filtering") else None
        sample = context.sampler.read(hits.place, footprint)
    with np.errstate(over="ignore", invalid="ignore"):  # render.py names the light
        radiance = _Block(context, hits, height, sample).radiance()
    if hits.seen is not None:
        radiance *= hits.seen
    return radiance


def _displaced(relief: Relief, hits: Hits) -> tuple[Hits, Array]:
    """The hits on the displaced surface, and the height there."""
    (u, v), height = parallax.shift(relief, hits.place, hits.to_view)
    moved = (
        (u - hits.place[0]).astype(np.float32),
        (v - hits.place[1]).astype(np.float32),
        height,
    )
    return replace(hits, point=add(hits.point, to_scene(moved, hits.frame)), place=(u, v)), height


class _Block:
    """One block's radiance while it is added up."""

    def __init__(
        self, context: ShadingContext, hits: Hits, height: Array, sample: SurfaceSample
    ) -> None:
        self.context, self.hits, self.height, self.sample = context, hits, height, sample
        self.plan = context.plan
        shape = np.broadcast_shapes(*(p.shape for p in hits.place), sample.alpha.shape)
        self.total = np.zeros((3, *shape), dtype=np.float32)
        self.n_dot_v = np.maximum(dot(sample.normal, hits.to_view), _ZERO)
        self.facing = (self.n_dot_v > 0.0) & (hits.to_view[2] > 0.0)
        self.scatter: list[tuple[Array, Array]] = []
        if self.plan.on("multiscatter"):
            with context.clock.on("multiscatter"):
                self.near = albedo().near(sample.alpha)
                self.scatter = [
                    multiscatter.terms(f0, self.near, self.n_dot_v) for f0 in sample.specular
                ]
        # For each colour the sum of irradiance times direction, for interreflection.
        self.flow: list[Vec] = [(_ZERO, _ZERO, _ZERO)] * 3 if self.bounces else []

    @property
    def bounces(self) -> bool:
        return self.plan.on("interreflection")

    def radiance(self) -> Array:
        skies = iter(self.context.skies)
        for light in self.context.scene.lights:
            if isinstance(light, EnvironmentLight):
                self.add_sky(next(skies))
            elif isinstance(light, SphereLight | RectangleLight):
                self.add_area(light)
            else:
                self.add_point(light)
        if self.bounces:
            with self.context.clock.on("interreflection"):
                self.add_bounce()
        if not self.facing.all():
            self.total *= self.facing
        return self.total

    def add_point(self, light: PointLight | DirectionalLight) -> None:
        if isinstance(light, DirectionalLight):
            direction = to_frame(vec(tuple(unit3(light.direction))), self.hits.frame)
            self.add(direction, self.lit(direction, None), light.irradiance)
            return
        offset = subtract(vec(light.position), self.hits.point)
        squared = np.maximum(dot(offset, offset), _NEAREST)
        inverse = 1.0 / np.sqrt(squared)
        to_light = to_frame(scale(offset, inverse), self.hits.frame)
        received: Any = inverse * inverse
        if not self.plan.on("falloff"):
            received = np.float32(1.0 / max(sum(c * c for c in light.position), 1e-12))
        self.add(to_light, received * self.lit(to_light, 1.0 / inverse), light.intensity)

    def add_area(self, light: SphereLight | RectangleLight) -> None:
        hits = self.hits
        if not self.plan.on("area"):
            node = area.centre(light, hits.point, hits.frame)
            received = self.fading(light, node) * self.lit(node.to_light, node.distance)
            self.add(node.to_light, received, light.radiance)
            return
        with self.context.clock.on("area"):
            offset = subtract(vec(light.position), hits.point)
            nearest = float(np.sqrt(dot(offset, offset).min()))
            order = area.order(light, nearest, float(self.sample.alpha.min()))
            shadow = self.area_shadow(light)
            for node in area.nodes(light, hits.point, hits.frame, order or 6):
                received = self.fading(light, node)
                if shadow:
                    received = received * shadow[_cell(light, node.place)]
                self.add(node.to_light, received, light.radiance, lobe=order is not None)
            if order is None and self.plan.on("specular"):
                seen = np.mean(list(shadow.values()), axis=0) if shadow else _ONE
                self.mirror(light, seen)

    def fading(self, light: SphereLight | RectangleLight, node: area.Node) -> Array:
        """The node's irradiance, with or without falloff."""
        if self.plan.on("falloff"):
            return node.received
        central = max(sum(c * c for c in light.position), 1e-12)
        offset = subtract(vec(light.position), self.hits.point)
        return node.received * (dot(offset, offset) * np.float32(1.0 / central))

    @property
    def casts(self) -> bool:
        return self.plan.on("shadows")

    def area_shadow(self, light: SphereLight | RectangleLight) -> dict[tuple[int, int], Array]:
        """What arrives from each of a light's 16 parts; empty where nothing casts shadows."""
        if not self.casts:
            return {}
        arriving: dict[tuple[int, int], Array] = {}
        above: dict[tuple[int, int], Array] = {}
        for probe in area.nodes(light, self.hits.point, self.hits.frame, 4):
            cell = _cell(light, probe.place)
            # What has set behind the surface itself is no matter of shadows.
            risen = (probe.to_light[2] > 0.0).astype(np.float32)
            lit = self.lit(probe.to_light, probe.distance) * risen
            arriving[cell] = arriving.get(cell, _ZERO) + lit
            above[cell] = above.get(cell, _ZERO) + risen
        return {
            cell: np.where(count > 0.0, arriving[cell] / np.maximum(count, _ONE), _ONE)
            for cell, count in above.items()
        }

    def mirror(self, light: SphereLight | RectangleLight, seen: Array) -> None:
        """The specular lobe of a light too large for a rule: the lobe is sampled instead.

        Args:
            light: the light.
            seen: share of it that shadows leave.
        """
        hits, sample = self.hits, self.sample
        lobe = lobe_of(sample, hits.to_view, self.n_dot_v)
        for point in lattice(area.SAMPLES):
            one = lobe.mirrored(point)
            direction = to_scene(one.to_light, hits.frame)
            met, _ = area.seen_along(light, hits.point, direction)
            met = met & (one.rise > 0.0)
            if not met.any():
                continue
            share = one.weight * met * seen
            for channel in range(3):
                f0 = sample.specular[channel if len(sample.specular) == 3 else 0]
                fresnel = f0 + (1.0 - f0) * one.fresnel
                self.total[channel] += share * fresnel * np.float32(light.radiance[channel])

    def lit(self, to_light: Vec, distance: Array | None) -> Any:  # noqa: ANN401
        """1 where light arrives past the relief, 0 where it does not."""
        if not self.casts:
            return np.float32(1.0)
        with self.context.clock.on("shadows"):
            return shadows.lit(
                self.context.relief, self.hits.place, self.height, to_light, distance
            ).astype(np.float32)

    def add(self, to_light: Vec, received: Array, colour: Colour, *, lobe: bool = True) -> None:
        """Add the light that arrives from one direction.

        Args:
            to_light: unit vector in the frame.
            received: irradiance on a surface facing it, for colour 1.
            colour: of the light.
            lobe: whether the specular lobe is lit too.
        """
        sample = self.sample
        n_dot_l = dot(sample.normal, to_light)
        np.maximum(n_dot_l, _ZERO, out=n_dot_l)
        risen = to_light[2] > 0.0
        if not risen.all():
            received = received * risen
        if self.bounces:
            self.collect(scale(to_light, received), colour)
        light = n_dot_l * received
        grey = colour[0] == colour[1] == colour[2]
        if grey:
            light *= np.float32(colour[0])
        glare: list[Array] = []
        if lobe and self.plan.on("specular"):
            with self.context.clock.on("specular"):
                mirror, l_dot_h = ggx_smith(
                    sample.normal, self.hits.to_view, to_light, self.n_dot_v, n_dot_l, sample.alpha
                )
                mirror *= light
                # F0 + (1 - F0) weight, times mirror.
                weight = schlick_weight(l_dot_h) * mirror
                mirror -= weight
                glare = [f0 * mirror for f0 in sample.specular]
                for one in glare:
                    one += weight
        if self.scatter:
            with self.context.clock.on("multiscatter"):
                lost = albedo().missing(self.near, n_dot_l)
                lost *= light
                extra = [strength * lost for strength, _ in self.scatter]
                glare = [a + b for a, b in zip(glare, extra, strict=True)] if glare else extra
        with self.context.clock.on("diffuse"):
            light *= np.float32(1.0 / math.pi)
            for channel in range(3):
                value = glare[channel if len(glare) == 3 else 0] if glare else _ZERO
                if self.plan.on("diffuse"):
                    value = sample.diffuse[channel] * light + value
                self.total[channel] += value if grey else value * np.float32(colour[channel])

    def collect(self, flow: Vec, colour: Colour) -> None:
        """Remember light, irradiance times direction, that neighbours receive."""
        for channel in range(3):
            self.flow[channel] = add(self.flow[channel], scale(flow, colour[channel]))

    def add_sky(self, sky: Environment) -> None:
        """Add the light of the surroundings."""
        sample, hits, context = self.sample, self.hits, self.context
        hides = self.plan.on("visibility")
        varied = self.plan.on("environment")
        seen: Any = np.float32(1.0)
        horizon = None
        if hides:
            with context.clock.on("visibility"):
                assert context.horizons is not None
                seen = context.sampler.extra(context.horizons.open, hits.place)[0]
                horizon = visibility.horizon_test(
                    context.horizons, context.sampler.nearest(hits.place)
                )
        with context.clock.on("environment"):
            if varied:
                irradiance = environment.diffuse_irradiance(sky, sample.normal, hits)
            else:
                irradiance = environment.uniform_irradiance(sky)
            irradiance = irradiance * seen
            if self.plan.on("diffuse"):
                for channel in range(3):
                    lambert = sample.diffuse[channel] * np.float32(1.0 / math.pi)
                    self.total[channel] += lambert * irradiance[channel]
            if self.plan.on("specular"):
                if varied:
                    parts = environment.specular(
                        sky, sample, hits, self.n_dot_v, context.samples, horizon
                    )
                else:
                    parts = environment.uniform_specular(sky, sample, self.n_dot_v)
                    parts = parts[0] * seen, parts[1] * seen
                for channel in range(3):
                    f0 = sample.specular[channel if len(sample.specular) == 3 else 0]
                    mirror = f0 * parts[0][channel] + parts[1][channel]
                    # The mean is taken away from what is sampled, and may leave less than nothing.
                    self.total[channel] += np.maximum(mirror, _ZERO)
        if self.scatter:
            with context.clock.on("multiscatter"):
                for channel in range(3):
                    _, share = self.scatter[channel if len(self.scatter) == 3 else 0]
                    self.total[channel] += share * irradiance[channel] * np.float32(1.0 / math.pi)
        if self.bounces:
            for channel, flow in enumerate(environment.irradiance_vector(sky, hits)):
                self.flow[channel] = add(self.flow[channel], flow)

    def add_bounce(self) -> None:
        """Add what neighbours reflect of all the light collected."""
        assert self.context.horizons is not None and self.context.horizons.bounced is not None
        bounced = self.context.sampler.extra(self.context.horizons.bounced, self.hits.place)
        arriving = interreflection.received(bounced, self.flow)
        for channel in range(3):
            lambert = self.sample.diffuse[channel] * np.float32(1.0 / math.pi)
            self.total[channel] += lambert * arriving[channel]


def _cell(light: SphereLight | RectangleLight, place: tuple[float, float]) -> tuple[int, int]:
    """Which of a light's parts a place in [0, 1] x [0, 1] belongs to: 4 x 4, or 2 rings of 8."""
    rows, columns = (2, 8) if isinstance(light, SphereLight) else (4, 4)
    return min(int(place[0] * rows), rows - 1), min(int(place[1] * columns), columns - 1)
