"""Radiance of a block of pixels: every light through every effect that the plan runs.

With a budget, an effect runs for those pixels of a tile only whose own bound says that they need
it. Without one it runs for all: that is the plain way, which the other is held to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from matcap.relight import compiled
from matcap.relight.budget import Budget
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
from matcap.relight.surfaces.hits import Hits, some, to_frame, to_scene
from matcap.relight.tables import albedo
from matcap.relight.tally import Tally
from matcap.relight.texel_horizons import COARSENESS, TexelHorizons
from matcap.relight.vectors import Array, Vec, add, dot, scale, subtract, unit3, vec
from matcap.relight.visible_normals import lattice, lobe_of

_ZERO: Any = np.float32(0.0)
_ONE: Any = np.float32(1.0)
# Plane units squared, from a point light: nearer, it would be in the surface.
_NEAREST: Any = np.float32(1e-12)
# What runs in every pixel where the plan has it.
_EVERYWHERE = ("diffuse", "specular", "falloff", "filtering", "parallax", "multiscatter")
# Radiance: with no tolerance at all, any change counts.
_TINY: Any = np.float32(1e-30)


@dataclass(frozen=True)
class ShadingContext:
    """What all blocks of a picture share.

    Attributes:
        scene: lights and surface.
        sampler: the material on the surface.
        relief: its height.
        plan: which effects run.
        skies: the environments, in the order of their lights.
        horizons: where ambient visibility or interreflection run, without a budget; and
        near: the same with one.
        clock: of the effects.
        samples: directions in which surroundings are mirrored.
        budget: what tiles may leave out; None where everything runs everywhere.
        tally: which tiles effects run in.
    """

    scene: Scene
    sampler: Sampler
    relief: Relief
    plan: Plan
    skies: tuple[Environment, ...]
    horizons: Horizons | None
    near: TexelHorizons | None
    clock: Clock
    samples: int
    budget: Budget | None
    tally: Tally


def shade(context: ShadingContext, hits: Hits, tiles: Array) -> Array:
    """(3, rows, W) radiance of a block; 0 where nothing is seen.

    Args:
        context: what all blocks share.
        hits: the block.
        tiles: (rows, W) which tile of the picture each pixel is in.
    """
    if context.budget is None or hits.seen is None:
        radiance = _shade(context, hits, tiles)
        if hits.seen is not None:
            radiance *= hits.seen
        return radiance
    index = np.flatnonzero(hits.seen)
    picture = np.zeros((3, hits.seen.size), dtype=np.float32)
    picture[:, index] = _shade(
        context, hits.take(index, hits.seen.shape), tiles.ravel()[index][None]
    )[:, 0]
    return picture.reshape(3, *hits.seen.shape)


def _shade(context: ShadingContext, hits: Hits, tiles: Array) -> Array:
    height: Array = np.zeros((1, 1), dtype=np.float32)
    if context.plan.on("parallax"):
        with context.clock.on("parallax"):
            hits, height = _displaced(context.relief, hits, quick=context.budget is not None)
    elif context.plan.on("shadows"):
        height = context.relief.at(*hits.place)
    with context.clock.on("filtering" if context.plan.on("filtering") else "reading"):
        footprint = hits.footprint if context.plan.on("filtering") else None
        sample = context.sampler.read(hits.place, footprint)
    with np.errstate(over="ignore", invalid="ignore"):  # render.py names the light
        return _Block(context, hits, height, sample, tiles).radiance()


def _displaced(relief: Relief, hits: Hits, *, quick: bool) -> tuple[Hits, Array]:
    """The hits on the displaced surface, and the height there."""
    (u, v), height = parallax.shift(relief, hits.place, hits.to_view, quick=quick)
    moved = (
        (u - hits.place[0]).astype(np.float32),
        (v - hits.place[1]).astype(np.float32),
        height,
    )
    return replace(hits, point=add(hits.point, to_scene(moved, hits.frame)), place=(u, v)), height


class _Block:
    """One block's radiance while it is added up."""

    def __init__(
        self,
        context: ShadingContext,
        hits: Hits,
        height: Array,
        sample: SurfaceSample,
        tiles: Array,
    ) -> None:
        self.context, self.hits, self.height, self.sample = context, hits, height, sample
        self.tiles = tiles
        self.plan = context.plan
        self.shape = shape = np.broadcast_shapes(
            *(p.shape for p in hits.place), *(d.shape for d in sample.diffuse)
        )
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

    def part(self, index: Array) -> _Block:
        """Some of the pixels, counted row by row, still dark."""
        shape = self.shape
        return _Block(
            self.context,
            self.hits.take(index, shape),
            some(self.height, index, shape),
            self.sample.take(index, shape),
            some(self.tiles, index, shape),
        )

    def take_back(self, part: _Block, index: Array) -> None:
        """Add what the lights of a part have done."""
        self.total.reshape(3, -1)[:, index] += part.total[:, 0]
        for channel, flow in enumerate(part.flow):
            whole = []
            for old, new in zip(self.flow[channel], flow, strict=True):
                field = np.array(np.broadcast_to(old, self.shape), dtype=np.float32)
                field.ravel()[index] += np.broadcast_to(new, part.shape)[0]
                whole.append(field)
            self.flow[channel] = (whole[0], whole[1], whole[2])

    def ran(self, effect: str, index: Array | None = None) -> None:
        """Note that an effect ran, in all pixels or in some."""
        if self.context.budget is not None:
            some_tiles = self.tiles if index is None else self.tiles.ravel()[index]
            self.context.tally.ran(effect, some_tiles)

    def radiance(self) -> Array:
        for effect in _EVERYWHERE:
            if self.plan.on(effect):
                self.ran(effect)
        # Surroundings last: what is known by then says how much of them may be left out.
        for light in self.context.scene.lights:
            if isinstance(light, SphereLight | RectangleLight):
                self.add_area(light)
            elif not isinstance(light, EnvironmentLight):
                self.add_point(light)
        for sky in self.context.skies:
            self.add_sky(sky)
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
            received = node.received * self.fading(light) * self.lit(node.to_light, node.distance)
            self.add(node.to_light, received, light.radiance)
            return
        with self.context.clock.on("area"):
            self.add_by_rules(light)

    def add_by_rules(self, light: SphereLight | RectangleLight) -> None:
        """Each pixel by the rule that its lobe asks for, with shadows where relief hides a part."""
        hits, sample, thrifty = self.hits, self.sample, self.context.budget is not None
        offset = subtract(vec(light.position), hits.point)
        distance = np.sqrt(dot(offset, offset))
        to_light = to_frame(scale(offset, 1.0 / distance), hits.frame)
        sets: Array = np.ones(1, dtype=bool)
        if thrifty:
            rule, sets = area.rules(
                light, distance, to_light, hits.to_view, sample.normal, sample.alpha, self.n_dot_v
            )
            rule = np.where(self.facing, rule, 0)
        else:
            rule = area.plain_rules(light, distance, sample.alpha)
        rule = np.broadcast_to(rule, self.shape).ravel()
        # Whether the rule is put together from the light's parts.
        parted = np.broadcast_to(sets & self.casts, self.shape).ravel().copy()
        index, shadow = np.flatnonzero(parted), np.ones((0, 0), dtype=np.float32)
        if self.casts and thrifty:
            # The light's lowest point against the highest that anything around can be.
            low = area.lowest(light, distance, to_light) < self.shelter
            index = np.flatnonzero((np.broadcast_to(low, self.shape).ravel() | parted) & (rule > 0))
        if len(index):
            shadow = self.part(index).area_shadow(light)
            if thrifty:
                parted[index] |= shadow.min(axis=0) < 1.0
        # Where in the list of those that shadows were looked for at each pixel is.
        listed = np.zeros(rule.shape, dtype=np.intp)
        listed[index] = np.arange(len(index))
        key = np.where(rule > 0, 2 * rule + parted, 0)
        for one in np.flatnonzero(np.bincount(key)).tolist():
            if one == 0:
                continue
            some_pixels = np.flatnonzero(key == one)
            part = self.part(some_pixels)
            cells = shadow[:, listed[some_pixels]] if one % 2 == 1 else None
            part.integrate(light, area.RULES.get(one // 2), cells)
            self.take_back(part, some_pixels)
            self.ran("area", some_pixels)

    def integrate(
        self,
        light: SphereLight | RectangleLight,
        order: int | None,
        shadow: Array | None,
    ) -> None:
        """Add the light of a rule of some order, or of the mirrored lobe without one.

        Args:
            light: the light.
            order: of the rule.
            shadow: (cells, N) share that arrives of each part of the light.
        """
        points = order or 6
        if shadow is not None:
            points = max(4 * math.ceil(points / 4), 12)
        rule, fading = area.rule(light, points, parts=shadow is not None), self.fading(light)
        if self.quick:
            pixels = self.as_lit(np.zeros((1, 1), dtype=np.float32))
            lobe = order is not None and self.plan.on("specular")
            sums = compiled.rule_sums(light, rule, pixels, self.total[0].size, shadow, lobe=lobe)
            self.add_sums(sums, fading, light.radiance)
        else:
            for node in area.nodes(light, rule, self.hits.point, self.hits.frame):
                received = node.received * fading
                if shadow is not None:
                    received = received * shadow[node.cell]
                self.add(node.to_light, received, light.radiance, lobe=order is not None)
        if order is None and self.plan.on("specular"):
            self.mirror(light, _ONE if shadow is None else shadow.mean(axis=0))

    def add_sums(self, sums: compiled.RuleSums, fading: Array, colour: Colour) -> None:
        """Add the light of all points of a rule at once."""
        sample = self.sample
        if self.bounces:
            self.collect(scale(sums.flow, fading), colour)
        lambert = sums.irradiance * np.float32(1.0 / math.pi)
        for channel in range(3):
            value: Array = np.zeros((1, 1), dtype=np.float32)
            if self.plan.on("diffuse"):
                value = sample.diffuse[channel] * lambert
            if self.plan.on("specular"):
                f0 = sample.specular[channel if len(sample.specular) == 3 else 0]
                value = value + (f0 * (sums.mirrored - sums.fresnel) + sums.fresnel)
            if self.scatter:
                value = value + self.scatter[channel % len(self.scatter)][0] * sums.lost
            self.total[channel] += value * (fading * np.float32(colour[channel]))

    def as_lit(self, shelter: Array) -> compiled.LitPixels:
        """The pixels as the compiled loops take them."""
        hits, sample = self.hits, self.sample
        near = self.near if self.scatter else None
        return compiled.LitPixels(
            hits, self.height, shelter, sample.normal, self.n_dot_v, sample.alpha, near
        )

    def fading(self, light: SphereLight | RectangleLight) -> Array:
        """Factor on the irradiance of a light's points: 1 where it falls off with distance."""
        if self.plan.on("falloff"):
            return np.ones((1, 1), dtype=np.float32)
        central = max(sum(c * c for c in light.position), 1e-12)
        offset = subtract(vec(light.position), self.hits.point)
        return dot(offset, offset) * np.float32(1.0 / central)

    @property
    def quick(self) -> bool:
        """Whether loops run compiled: where tiles are decided, and there is a compiled form."""
        return self.context.budget is not None and compiled.kernel() is not None

    @property
    def casts(self) -> bool:
        return self.plan.on("shadows")

    @cached_property
    def shelter(self) -> Array:
        """Tangents of elevations from which on nothing hides a light."""
        relief = self.context.relief
        u, v = np.broadcast_arrays(*self.hits.place)
        with self.context.clock.on("shadows"):
            return relief.shelter(u, v, np.broadcast_to(self.height, u.shape))

    def area_shadow(self, light: SphereLight | RectangleLight) -> Array:
        """(cells, N) share that arrives from each of a light's 16 parts."""
        rule = area.rule(light, 4)
        if self.quick:
            shelter, relief = self.shelter, self.context.relief
            with self.context.clock.on("shadows"):
                found = compiled.parts_lit(
                    relief, light, rule, self.as_lit(shelter), self.total[0].size
                )
            self.ran("shadows", np.flatnonzero(found.min(axis=0) < 1.0))
            return found
        arriving, above = np.zeros((2, rule.cells, *self.shape), dtype=np.float32)
        for probe in area.nodes(light, rule, self.hits.point, self.hits.frame):
            # What has set behind the surface itself is no matter of shadows.
            risen = (probe.to_light[2] > 0.0).astype(np.float32)
            arriving[probe.cell] += self.lit(probe.to_light, probe.distance) * risen
            above[probe.cell] += risen
        found = np.where(above > 0.0, arriving / np.maximum(above, _ONE), _ONE)
        return found.reshape(rule.cells, -1)

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
        relief, place = self.context.relief, self.hits.place
        if self.context.budget is None:
            with self.context.clock.on("shadows"):
                found = shadows.lit(relief, place, self.height, to_light, distance)
                return found.astype(np.float32)
        shelter = self.shelter
        with self.context.clock.on("shadows"):
            x, y, z = to_light
            low = z < shelter * np.sqrt(x * x + y * y)
            low = np.broadcast_to(low & (z > 0.0) & self.facing, self.shape)
            index = np.flatnonzero(low)
            lit = np.ones(self.shape, dtype=np.float32)
            if len(index):
                far = None if distance is None else some(distance, index, self.shape)
                u, v, h, x, y, z = (
                    some(one, index, self.shape) for one in (*place, self.height, *to_light)
                )
                cast = compiled.lit if self.quick else shadows.lit
                lit.ravel()[index] = cast(relief, (u, v), h, (x, y, z), far)[0]
                self.ran("shadows", index)
            return lit

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
                if context.near is not None:
                    seen = self.surroundings[0]
                    self.ran("visibility")
                else:
                    assert context.horizons is not None
                    seen = context.sampler.extra(context.horizons.open, hits.place)[0]
                    horizon = visibility.HorizonTest(
                        context.horizons.tangents, context.sampler.nearest(hits.place)
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
                if varied and context.budget is not None:
                    parts = self.mirrored_sky(sky, context.budget)
                elif varied:
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

    @cached_property
    def surroundings(self) -> Array:
        """(2, ...) what of the surroundings is open, and how much of neighbours is seen."""
        near, sampler, place = self.context.near, self.context.sampler, self.hits.place
        assert near is not None
        near.see(sampler.corners(place).ravel())
        return sampler.extra(near.open, place)

    def mirrored_sky(self, sky: Environment, budget: Budget) -> tuple[Array, Array]:
        """As environment.specular(), in no more pixels than the budget asks for."""
        sample, hits, context = self.sample, self.hits, self.context
        even = environment.uniform_specular(sky.calm, sample, self.n_dot_v)
        scale, bias = (np.array(np.broadcast_to(part, self.total.shape)) for part in even)
        needed = np.zeros(self.shape, dtype=bool)
        if sky.varying > 0.0 or sky.suns:
            needed |= self.facing
        else:
            # At most all of it is hidden.
            allowed = budget.radiance("environment", self.total)
            for channel in range(3):
                f0 = sample.specular[channel if len(sample.specular) == 3 else 0]
                needed |= f0 * scale[channel] + bias[channel] > allowed[channel]
            needed &= self.facing
        index = np.flatnonzero(needed)
        if len(index):
            u, v = (some(one, index, self.shape) for one in hits.place)
            place = (u, v)
            horizon = None
            highest: Array = np.zeros((1, 1), dtype=np.float32)
            if context.near is not None and self.plan.on("visibility"):
                texel = context.sampler.nearest(place)
                context.near.see(texel.ravel())
                horizon = visibility.HorizonTest(context.near.tangents, texel)
                steepest = np.maximum(context.near.steepest(texel), _ZERO)
                highest = steepest / np.sqrt(_ONE + steepest * steepest) + np.float32(1e-5)
            part = environment.specular(
                sky,
                sample.take(index, self.shape),
                hits.take(index, self.shape),
                some(self.n_dot_v, index, self.shape),
                context.samples,
                horizon,
                highest,
            )
            scale.reshape(3, -1)[:, index] = part[0][:, 0]
            bias.reshape(3, -1)[:, index] = part[1][:, 0]
            self.ran("environment", index)
        return scale, bias

    def add_bounce(self) -> None:
        """Add what neighbours reflect of all the light collected."""
        if self.context.near is not None:
            self.add_needed_bounce(self.context.near)
            return
        assert self.context.horizons is not None and self.context.horizons.bounced is not None
        bounced = self.context.sampler.extra(self.context.horizons.bounced, self.hits.place)
        arriving = interreflection.received(bounced, self.flow)
        for channel in range(3):
            lambert = self.sample.diffuse[channel] * np.float32(1.0 / math.pi)
            self.total[channel] += lambert * arriving[channel]

    def add_needed_bounce(self, near: TexelHorizons) -> None:
        """The same where it may matter, as finely as it may."""
        context, budget = self.context, self.context.budget
        assert budget is not None
        allowed = budget.radiance("interreflection", self.total)
        facing = self.surroundings[1]
        most = np.zeros(self.shape, dtype=np.float32)
        for channel in range(3):
            flow = np.sqrt(dot(self.flow[channel], self.flow[channel]))
            largest = np.float32(context.relief.texture.brightest[channel] / math.pi)
            change = self.sample.diffuse[channel] * flow * facing * largest
            np.maximum(most, change / np.maximum(allowed[channel], _TINY), out=most)
        most *= self.facing
        coarse = (most > 1.0) & (most * np.float32(COARSENESS) <= 1.0)
        for fine, which in ((False, coarse), (True, most * np.float32(COARSENESS) > 1.0)):
            index = np.flatnonzero(which)
            if not len(index):
                continue
            u, v = (some(one, index, self.shape) for one in self.hits.place)
            if fine:
                bounced = context.sampler.between(near.fine, (u, v))
            else:
                known = near.coarse(context.sampler.corners((u, v)).ravel())
                bounced = context.sampler.extra(known, (u, v))
            flows = [_some(flow, index, self.shape) for flow in self.flow]
            for channel, arriving in enumerate(interreflection.received(bounced, flows)):
                lambert = some(self.sample.diffuse[channel], index, self.shape)
                reflected = lambert * arriving * np.float32(1.0 / math.pi)
                self.total[channel].ravel()[index] += reflected[0]
            self.ran("interreflection", index)


def _some(vector: Vec, index: Array, shape: tuple[int, ...]) -> Vec:
    x, y, z = (some(one, index, shape) for one in vector)
    return x, y, z
