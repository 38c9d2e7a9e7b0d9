"""Area lights, integrated over what a point sees of them.

Rectangle: a Gauss-Legendre product rule over its area. Sphere: the cone it fills, Gauss-Legendre
in the cosine and even in azimuth. The rule grows with the light's size against the sharpest lobe
of each pixel, from 3 x 3 to 16 x 16 points. Where even that is too coarse (a large light in a
near-mirror) the specular lobe is sampled instead, at 144 visible normals, each of which sees the
light or does not. Where tiles are decided on their own, each pixel has the rule that its own lobe
asks for, as far from its peak as the light is. Where relief hides a part of a light the rule is put
together from rules for its 16 parts, each as dark as the rays to it find it; rays that are steeper
than anything around are not followed (Relief.clear). A light that sets behind the horizon of a
point makes the integrand bend, which costs accuracy there, and takes 12 x 12 points.

Left out: all light comes from the light's middle, with the intensity of the whole. Cost: 9 to 256
point lights.
"""

from __future__ import annotations

import math
from ctypes import byref
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.loops.library import LANES, KeptArrays, Whole, address, loops
from matcap.relight.loops.structures import CAreaLight, CRule, directions
from matcap.relight.scene import RectangleLight, SphereLight
from matcap.relight.scene_bounds import SceneBounds
from matcap.relight.vectors import Array, unit3

if TYPE_CHECKING:
    from matcap.relight.block import Block

AreaLight = RectangleLight | SphereLight
SAMPLES = 144
# Points along a side of the rules that pixels choose from; what is beyond the last is sampled.
ORDERS = (3, 4, 6, 8, 12, 16)
# Points of the rule to the angle of a lobe, alpha: measured errors stay below 4e-4.
_DENSITY = 1.5
# The same pixel by pixel, where errors may be as large as a share of the tolerance: points to a
# lobe's width and to the angle of the light; how far the microfacet turns. Measured on leather
# between softboxes, without shadows: with three quarters of these, no code is off by more than 0.4
# of half a step.
_RATE, _SPREAD, _TURN = 1.0, 2.0, 0.6
# Where rays are clear takes 0.04 microseconds a texel to find, and saves 0.2 a pixel and more.
_TEXELS_A_PIXEL = 4


@dataclass(frozen=True, eq=False)
class Rule:
    """Points of a light, (N,) arrays."""

    places: tuple[Array, Array, Array]
    """Of a rectangle: x, y and z in the scene. Of a sphere: how far from the middle of the cap that
    shows, in [0, 1] of what its height is, and cosine and sine of the turn."""
    weights: Array
    """Of a rectangle they add up to 1, of a sphere's cap to 2 pi."""
    cell: Array
    """Which part of the light each is in: of 4 x 4, or of 2 rings of 8."""
    cells: int = 16
    """How many parts there are."""


def bound(limits: SceneBounds) -> Bound:
    """The light's angular radius against how fast the lobes change with direction."""
    sized = [light for light in limits.lights if light.half_angle > 0.0]
    if not sized:
        return Bound(0.0, "no light has a size")
    widest = max(light.half_angle for light in sized)
    # d ln D / d angle <= 2 / alpha, and n.l, n.v, l.h may each be as small as alpha.
    steepness = 16.0 / limits.alpha[0] ** 2
    total = sum(
        min(
            light.irradiance
            * min(light.half_angle, 1.0)
            * (4.0 * limits.lambert + steepness * limits.glossy(light)),
            # Neither picture is darker than black, nor brighter than the light can make it.
            limits.radiance(light),
        )
        for light in sized
    )
    return Bound(total, f"lights of up to {math.degrees(widest):.2g} degrees' radius")


def add(block: Block, light: AreaLight) -> None:
    """Add a light with a size."""
    plan, relief = block.plan, block.context.relief
    c_light, _ = _as_c(
        light,
        falls=plan.on("falloff"),
        diffuse=plan.on("diffuse"),
        specular=plan.on("specular"),
    )
    ran, field = np.zeros(block.tiles.size, dtype=np.uint8), None
    if plan.on("shadows"):
        pixels, texels = math.prod(block.context.tally.size), len(relief.heights)
        swift = block.adaptive and texels <= _TEXELS_A_PIXEL * pixels
        field = byref(relief.swift if swift else relief.field)
    with block.context.clock.on("area"):
        loops().matcap_relight_area(
            byref(block.as_c), byref(c_light), field,
            byref(directions(SAMPLES)[0]), Whole(block.adaptive), address(ran),
        )  # fmt: skip
    block.ran("area", ran > 0)
    block.ran("shadows", ran > 1)


@lru_cache(maxsize=64)
def _as_c(
    light: AreaLight, *, falls: bool, diffuse: bool, specular: bool
) -> tuple[CAreaLight, KeptArrays]:
    """The light as a C structure, with all quadrature rules a pixel may choose."""
    kept, central = KeptArrays(), max(sum(c * c for c in light.position), 1e-12)
    c_light = CAreaLight(
        place=light.position, colour=light.radiance, half=_half(light),
        even=0.0 if falls else 1.0 / central, density=_DENSITY, rate=_RATE, spread=_SPREAD,
        turn=_TURN, diffuse=diffuse, specular=specular, limits=ORDERS,
    )  # fmt: skip
    if isinstance(light, SphereLight):
        c_light.radius = light.radius
    else:
        c_light.across, c_light.along, c_light.normal = (tuple(axis) for axis in _axes(light))
        c_light.size = light.size
    # Beyond the last order the lobe is sampled, and this is for diffuse light.
    for number, order in enumerate((*ORDERS, 6), start=1):
        c_light.plain[number] = _rule(rule(light, order), order, kept)
        parted = 12 if number > len(ORDERS) else max(4 * math.ceil(order / 4), 8)
        c_light.parted[number] = _rule(rule(light, parted, parts=True), parted, kept)
    c_light.probe = _rule(rule(light, 4), 4, kept)
    return c_light, kept


def _rule(rule: Rule, order: int, kept: KeptArrays) -> CRule:
    count = len(rule.weights)
    size = count + -count % LANES
    # Points too many are the last one again, and weigh nothing.
    which = np.minimum(np.arange(size), count - 1)
    places = (kept.of(one[which]) for one in rule.places)
    weights = rule.weights[which] * (np.arange(size) < count)
    return CRule(*places, kept.of(weights), kept.of(rule.cell[which], np.int32), size, order)


def _half(light: AreaLight) -> float:
    """Radius of a light around its middle."""
    return light.radius if isinstance(light, SphereLight) else math.hypot(*light.size) / 2.0


@lru_cache(maxsize=64)
def rule(light: AreaLight, order: int, *, parts: bool = False) -> Rule:
    """The points of a rule of some order.

    Args:
        light: the light.
        order: points along a side.
        parts: make each of the 16 parts of which shadows are known weigh what it measures; the
            order is then a multiple of 4.
    """
    first, second, weights, cell = _points(isinstance(light, SphereLight), order, parts)
    if isinstance(light, SphereLight):
        return Rule((first, np.cos(second), np.sin(second)), weights, cell)
    across, along, _ = _axes(light)
    one, two = (first - 0.5) * light.size[0], (second - 0.5) * light.size[1]
    px, py, pz = (light.position[k] + across[k] * one + along[k] * two for k in range(3))
    return Rule((px, py, pz), weights, cell)


@lru_cache(maxsize=32)
def _points(around: bool, order: int, parts: bool) -> tuple[Array, Array, Array, Array]:
    """Points of [0, 1] x [0, 1], or of [0, 1] and a turn, their weights and parts."""
    pieces = 1 if not parts else 2 if around else 4
    x, weights = np.polynomial.legendre.leggauss(order // pieces)
    x = ((x + 1.0) / 2.0 + np.arange(pieces)[:, None]).ravel() / pieces
    weights = np.tile(weights / (2.0 * pieces), pieces)
    if not around:
        a, b = (grid.ravel() for grid in np.meshgrid(x, x, indexing="ij"))
        return a, b, np.outer(weights, weights).ravel(), _cells(a, b, 4, 4)
    turns = 2 * len(x)
    i, turn = (grid.ravel() for grid in np.mgrid[: len(x), :turns])
    angle = 2.0 * math.pi * (turn + 0.5 * (i % 2)) / turns
    return x[i], angle, 2.0 * math.pi * weights[i] / turns, _cells(x[i], turn / turns, 2, 8)


def _cells(first: Array, second: Array, rows: int, columns: int) -> Array:
    """Which of the light's parts points of [0, 1] x [0, 1] belong to."""
    row = np.minimum((first * rows).astype(np.intp), rows - 1)
    cell: Array = row * columns + np.minimum((second * columns).astype(np.intp), columns - 1)
    return cell


def _axes(
    light: RectangleLight,
) -> tuple[Array, Array, Array]:
    """Unit vectors across, along `up`, and out of a rectangle."""
    normal = unit3(light.normal)
    up = np.asarray(light.up, dtype=np.float64)
    along = unit3(tuple(up - normal * (up @ normal)))
    return np.cross(along, normal), along, normal
