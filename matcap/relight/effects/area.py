"""Area lights, integrated by quadrature over the solid angle that a point sees.

- Rectangle: Gauss-Legendre product rule over its area. Sphere: over its cone of directions,
  Gauss-Legendre in the cosine, uniform in azimuth.
- Order: 3 x 3 to 16 x 16 points, by the light's angular size over the width of the pixel's specular
  lobe; with a budget also by the light's distance from the lobe's peak.
- If 16 x 16 is too coarse (a large light in a near-mirror), the specular lobe is sampled instead:
  144 visible normals, whose mirrored directions meet the light or miss it.
- Shadows: one ray to each point of a 4 x 4 rule gives the visible share of each of 16 parts of the
  light; the quadrature is then composite, part by part. Rays above Relief.clear_tangents are not
  cast.
- A light that is partly below a point's horizon has a kink in its integrand: 12 x 12 points; with
  a budget 8 x 8 of a rectangle that only the shading normal turns from.

Left out: a point light in the middle of the light, with its radiant intensity. Cost: 9 to 256 point
lights.
"""

from __future__ import annotations

import math
from ctypes import byref
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from matcap.relight.block import Block
from matcap.relight.camera import Array, unit3
from matcap.relight.effects import Bound
from matcap.relight.loops.library import (
    LANES,
    CAreaLight,
    CRule,
    KeptArrays,
    Whole,
    address,
    directions,
    loops,
)
from matcap.relight.plan import SceneBounds
from matcap.relight.scene import RectangleLight, SphereLight

AreaLight = RectangleLight | SphereLight
SAMPLES = 144
# Orders (points along a side) of the rules; where the last is too coarse the lobe is sampled.
ORDERS = (3, 4, 6, 8, 12, 16)
# Points along a side for each angle alpha (radians) that the light spans; error below 4e-4.
_DENSITY = 1.5
# With a budget: points for each lobe width at the light's distance from the peak, points for each
# radian of the light, and turn of the microfacet for each radian of the light. With three quarters
# of these values, leather between softboxes without shadows is off by 0.4 of half an 8-bit step.
_RATE, _SPREAD, _TURN = 1.0, 2.0, 0.6
# Relief.clear_tangents costs 0.04 us a texel and saves 0.2 us a pixel or more: worth it up to this.
_TEXELS_A_PIXEL = 4


@dataclass(frozen=True, eq=False)
class Rule:
    """A quadrature rule: N points of a light, (N,) arrays."""

    places: tuple[Array, Array, Array]
    """Sample points. Of a rectangle: x, y, z in the scene. Of a sphere: (1 - cosine) over that of
    the cone's edge, [0, 1], and cosine and sine of the azimuth."""
    weights: Array
    """Sum to 1 over a rectangle, to 2 pi over a sphere's cone."""
    cell: Array
    """Part of the light that each point is in: 4 x 4 of a rectangle, 2 rings of 8 of a sphere."""


def bound(limits: SceneBounds) -> Bound:
    """Irradiance times angular radius times the largest derivative of BRDF n.l by direction."""
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
            # Both pictures are between 0 and the light's largest radiance.
            limits.radiance(light),
        )
        for light in sized
    )
    return Bound(total, f"lights of up to {math.degrees(widest):.2g} degrees' radius")


def add(block: Block, light: AreaLight) -> None:
    """Add the light's radiance to a block."""
    plan, relief = block.plan, block.context.relief
    c_light = _as_c(
        light, falls=plan.on("falloff"), diffuse=plan.on("diffuse"), specular=plan.on("specular")
    )
    ran, field = np.zeros(block.tiles.size, dtype=np.uint8), None
    if plan.on("shadows"):
        pixels, texels = math.prod(block.context.tally.size), len(relief.heights)
        bounded = block.adaptive and texels <= _TEXELS_A_PIXEL * pixels
        field = byref(relief.bounded_field if bounded else relief.field)
    with block.context.tally.timed("area"):
        loops().matcap_relight_area(
            byref(block.as_c), byref(c_light), field,
            byref(directions(SAMPLES)), Whole(block.adaptive), address(ran),
        )  # fmt: skip
    block.ran("area", ran > 0)
    block.ran("shadows", ran > 1)


@lru_cache(maxsize=64)
def _as_c(light: AreaLight, *, falls: bool, diffuse: bool, specular: bool) -> CAreaLight:
    """The light as a C structure, with the quadrature rules of all orders."""
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
    # After the last order: for the diffuse lobe where the specular one is sampled.
    for number, order in enumerate((*ORDERS, 6), start=1):
        c_light.plain[number] = _rule(rule(light, order), order, kept)
        parted = 12 if number > len(ORDERS) else max(4 * math.ceil(order / 4), 8)
        c_light.parted[number] = _rule(rule(light, parted, parts=True), parted, kept)
    c_light.probe = _rule(rule(light, 4), 4, kept)
    return kept.kept_by(c_light)


def _rule(rule: Rule, order: int, kept: KeptArrays) -> CRule:
    count = len(rule.weights)
    size = count + -count % LANES
    # Padded to a multiple of LANES with points of weight 0.
    which = np.minimum(np.arange(size), count - 1)
    places = (kept.of(one[which]) for one in rule.places)
    weights = rule.weights[which] * (np.arange(size) < count)
    return CRule(*places, kept.of(weights), kept.of(rule.cell[which], np.int32), size, order)


def _half(light: AreaLight) -> float:
    """Radius of the light's bounding sphere."""
    return light.radius if isinstance(light, SphereLight) else math.hypot(*light.size) / 2.0


@lru_cache(maxsize=64)
def rule(light: AreaLight, order: int, *, parts: bool = False) -> Rule:
    """The quadrature rule of an order.

    Args:
        order: points along a side; a multiple of 4 with `parts`.
        parts: compose it of one rule for each of the 16 parts, so that shadows of parts weigh by
            their solid angle.
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
    """Points of [0, 1]^2, or if `around` of [0, 1] and an azimuth; their weights and parts."""
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
    """Index of the part of the light that each point of [0, 1]^2 is in."""
    row = np.minimum((first * rows).astype(np.intp), rows - 1)
    return row * columns + np.minimum((second * columns).astype(np.intp), columns - 1)


def _axes(light: RectangleLight) -> tuple[Array, Array, Array]:
    """Unit vectors across a rectangle, along its `up`, and along its normal."""
    normal = unit3(light.normal)
    up = np.asarray(light.up, dtype=np.float64)
    along = unit3(tuple(up - normal * (up @ normal)))
    return np.cross(along, normal), along, normal
