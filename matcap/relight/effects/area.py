"""Area lights, integrated over what a point sees of them.

Rectangle: a Gauss-Legendre product rule over its area. Sphere: the cone it fills, Gauss-Legendre
in the cosine and even in azimuth. The rule grows with the light's size against the sharpest lobe
of each pixel, from 3 x 3 to 16 x 16 points. Where even that is too coarse (a large light in a
near-mirror) the specular lobe is sampled instead, at 144 visible normals, each of which sees the
light or does not. Where tiles are decided on their own, each pixel has the rule that its own lobe
asks for, as far from its peak as the light is. Where relief hides a part of a light the rule is put
together from rules for its 16 parts. A light that sets behind the horizon of a point makes the
integrand bend, which costs accuracy there.

Left out: all light comes from the light's middle, with the intensity of the whole. Cost: 9 to 256
point lights.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.facts import Facts
from matcap.relight.scene import RectangleLight, SphereLight
from matcap.relight.surfaces.hits import TangentFrame, to_frame
from matcap.relight.vectors import Array, Vec, add, cross, dot, scale, subtract, unit3, vec
from matcap.relight.visible_normals import basis

AreaLight = RectangleLight | SphereLight
SAMPLES = 144
# Rules that pixels choose from, by their number; what is beyond the last mirrors the lobe.
RULES = {1: 3, 2: 4, 3: 6, 4: 8, 5: 12, 6: 16}
# Points of the rule to the angle of a lobe, alpha: measured errors stay below 4e-4.
_DENSITY = 1.5
# The same pixel by pixel, where errors may be as large as a share of the tolerance: points to a
# lobe's width and to the angle of the light; how far the microfacet turns. Measured on leather
# between softboxes, without shadows: with three quarters of these, no code is off by more than 0.4
# of half a step.
_RATE, _SPREAD, _TURN = 1.0, 2.0, 0.6


@dataclass(frozen=True)
class Node:
    """One point of a light, seen from each pixel of a block.

    Attributes:
        to_light: unit vector in the material's frame.
        received: irradiance on a surface facing it, for radiance 1.
        distance: to the light.
        cell: which of the light's parts the point is in.
    """

    to_light: Vec
    received: Array
    distance: Array
    cell: int


@dataclass(frozen=True, eq=False)
class Rule:
    """Points of a light, (N,) arrays.

    Attributes:
        places: of a rectangle: x, y and z in the scene. Of a sphere: how far from the middle of
            the cap that shows, in [0, 1] of what its height is, and cosine and sine of the turn.
        weights: of a rectangle they add up to 1, of a sphere's cap to 2 pi.
        cell: which part of the light each is in: of 4 x 4, or of 2 rings of 8.
        cells: how many parts there are.
    """

    places: tuple[Array, Array, Array]
    weights: Array
    cell: Array
    cells: int = 16


def bound(facts: Facts) -> Bound:
    """The light's angular radius against how fast the lobes change with direction."""
    sized = [light for light in facts.lights if light.half_angle > 0.0]
    if not sized:
        return Bound(0.0, "no light has a size")
    widest = max(light.half_angle for light in sized)
    # d ln D / d angle <= 2 / alpha, and n.l, n.v, l.h may each be as small as alpha.
    steepness = 16.0 / facts.alpha[0] ** 2
    total = sum(
        min(
            light.irradiance
            * min(light.half_angle, 1.0)
            * (4.0 * facts.lambert + steepness * facts.glossy(light)),
            # Neither picture is darker than black, nor brighter than the light can make it.
            facts.radiance(light),
        )
        for light in sized
    )
    return Bound(total, f"lights of up to {math.degrees(widest):.2g} degrees' radius")


def plain_rules(light: AreaLight, distance: Array, alpha: Array) -> Array:
    """Which of RULES each pixel needs wherever its lobe points, or 7 for none of them.

    Args:
        light: the light.
        distance: to its middle.
        alpha: GGX's.
    """
    angle = _angle(light, distance)
    needed = 3.0 + np.ceil(_DENSITY * angle / (2.0 * np.maximum(alpha, 1e-6)) + 6.0 * angle)
    return _number(needed)


def _number(needed: Array) -> Array:
    limits = np.array(list(RULES.values()), dtype=np.float32)
    return np.searchsorted(limits, np.minimum(needed, np.float32(1e6))) + 1


def _angle(light: AreaLight, distance: Array) -> Array:
    """The light's angular radius, and more where it is near."""
    half = np.float32(_half(light))
    angle: Array = np.arctan2(half, np.maximum(distance - half, np.float32(1e-6)))
    return angle


def rules(
    light: AreaLight,
    distance: Array,
    to_light: Vec,
    to_view: Vec,
    normal: Vec,
    alpha: Array,
    n_dot_v: Array,
) -> tuple[Array, Array]:
    """Which of RULES each pixel needs, or 7 as plain_rules(); 0 where the light is below.

    Away from its peak a lobe changes no faster than its distance from there lets it: GGX is
    (alpha^2 + t^2)^-2 in the tangent t between normal and microfacet, whose nearest singularity
    is that far off the light's range of t. Where the light sets what it gives has an edge, which
    no rule of few points meets: there it is plain_rules().

    Returns:
        The numbers, and where the light sets.

    Args:
        light: the light.
        distance: to its middle.
        to_light: unit vectors to its middle.
        to_view, normal: unit vectors.
        alpha: GGX's.
        n_dot_v: cosine of the view.
    """
    angle = _angle(light, distance)
    n_dot_l = dot(normal, to_light)
    middle = add(to_light, to_view)
    cosine = n_dot_l + n_dot_v
    squared = np.maximum(dot(middle, middle) - cosine * cosine, np.float32(0.0))
    away = np.arctan2(np.sqrt(squared), np.maximum(cosine, np.float32(1e-6)))
    # The microfacet turns half as far as the light, and a little more at grazing views.
    clear = np.tan(np.clip(away - angle * np.float32(_TURN), np.float32(0.0), np.float32(1.5)))
    sharp = np.sqrt(alpha * alpha + clear * clear)
    # Where the light sets behind the normal, or the surface.
    sine = np.sin(np.minimum(angle, np.float32(math.pi / 2.0)))
    lowest = np.minimum(n_dot_l, to_light[2])
    sets = lowest < sine
    needed = 2.0 + np.float32(_RATE) * angle / sharp + np.float32(_SPREAD) * angle
    plain = plain_rules(light, distance, alpha)
    number = np.where(sets | (plain > len(RULES)), plain, np.minimum(_number(needed), plain))
    return np.where(lowest < -sine, 0, number), sets


def lowest(light: AreaLight, distance: Array, to_light: Vec) -> Array:
    """Tangent of the lowest elevation of any of a light's points, at least."""
    sine = np.minimum(np.float32(_half(light)) / np.maximum(distance, np.float32(1e-12)), 1.0)
    elevation = np.arcsin(np.clip(to_light[2], -1.0, 1.0)) - np.arcsin(sine)
    return np.tan(np.maximum(elevation, np.float32(-1.5)))


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
    pieces = 1 if not parts else 2 if isinstance(light, SphereLight) else 4
    x, weights = np.polynomial.legendre.leggauss(order // pieces)
    x = ((x + 1.0) / 2.0 + np.arange(pieces)[:, None]).ravel() / pieces
    weights = np.tile(weights / (2.0 * pieces), pieces)
    if isinstance(light, SphereLight):
        turns = 2 * len(x)
        i, turn = (grid.ravel() for grid in np.mgrid[: len(x), :turns])
        angle = 2.0 * math.pi * (turn + 0.5 * (i % 2)) / turns
        places = x[i], np.cos(angle), np.sin(angle)
        return Rule(places, 2.0 * math.pi * weights[i] / turns, _cells(x[i], turn / turns, 2, 8))
    across, along, _ = _axes(light)
    a, b = (grid.ravel() for grid in np.meshgrid(x, x, indexing="ij"))
    one, two = (a - 0.5) * light.size[0], (b - 0.5) * light.size[1]
    px, py, pz = (light.position[k] + across[k] * one + along[k] * two for k in range(3))
    return Rule((px, py, pz), np.outer(weights, weights).ravel(), _cells(a, b, 4, 4))


def _cells(first: Array, second: Array, rows: int, columns: int) -> Array:
    """Which of the light's parts points of [0, 1] x [0, 1] belong to."""
    row = np.minimum((first * rows).astype(np.intp), rows - 1)
    cell: Array = row * columns + np.minimum((second * columns).astype(np.intp), columns - 1)
    return cell


def nodes(light: AreaLight, rule: Rule, point: Vec, frame: TangentFrame | None) -> Iterator[Node]:
    """The points of a rule, seen from the pixels of a block."""
    seen = _sphere if isinstance(light, SphereLight) else _rectangle
    yield from seen(light, rule, point, frame)  # type: ignore[arg-type]


def centre(light: AreaLight, point: Vec, frame: TangentFrame | None) -> Node:
    """The light as a point in its middle."""
    if isinstance(light, RectangleLight):
        x, y, z = (np.array([c]) for c in light.position)
        one = Rule((x, y, z), np.ones(1), np.zeros(1, dtype=np.intp))
        return next(_rectangle(light, one, point, frame))
    offset = subtract(vec(light.position), point)
    squared = dot(offset, offset)
    inverse = 1.0 / np.sqrt(squared)
    received = np.float32(math.pi * light.radius**2) / squared
    return Node(to_frame(scale(offset, inverse), frame), received, 1.0 / inverse, 0)


def seen_along(light: AreaLight, point: Vec, direction: Vec) -> tuple[Array, tuple[Array, Array]]:
    """Whether directions of the scene meet a light, and where on it, in [0, 1] twice."""
    if isinstance(light, RectangleLight):
        across, along, normal = _axes(light)
        offset = subtract(vec(light.position), point)
        facing = -dot(direction, vec(tuple(normal)))
        safe = np.maximum(facing, np.float32(1e-6))
        reach = -dot(offset, vec(tuple(normal))) / safe
        miss = subtract(scale(direction, reach), offset)
        a = dot(miss, vec(tuple(across))) / np.float32(light.size[0]) + np.float32(0.5)
        b = dot(miss, vec(tuple(along))) / np.float32(light.size[1]) + np.float32(0.5)
        met = (facing > 1e-6) & (reach > 0) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
        return met, (a, b)
    offset = subtract(vec(light.position), point)
    sideways = cross(direction, offset)
    met = (dot(sideways, sideways) <= np.float32(light.radius**2)) & (dot(direction, offset) > 0)
    half = np.full(met.shape, 0.5, dtype=np.float32)
    return met, (half, half)


def _axes(
    light: RectangleLight,
) -> tuple[Array, Array, Array]:
    """Unit vectors across, along `up`, and out of a rectangle."""
    normal = unit3(light.normal)
    up = np.asarray(light.up, dtype=np.float64)
    along = unit3(tuple(up - normal * (up @ normal)))
    return np.cross(along, normal), along, normal


def _rectangle(
    light: RectangleLight, rule: Rule, point: Vec, frame: TangentFrame | None
) -> Iterator[Node]:
    _, _, normal = _axes(light)
    area = light.size[0] * light.size[1]
    for *place, weight, cell in zip(*rule.places, rule.weights, rule.cell, strict=True):
        offset = subtract(vec((place[0], place[1], place[2])), point)
        squared = dot(offset, offset)
        inverse = 1.0 / np.sqrt(squared)
        facing = np.maximum(-dot(offset, vec(tuple(normal))) * inverse, np.float32(0.0))
        received = facing * np.float32(area * weight) / squared
        yield Node(to_frame(scale(offset, inverse), frame), received, 1.0 / inverse, int(cell))


def _sphere(
    light: SphereLight, rule: Rule, point: Vec, frame: TangentFrame | None
) -> Iterator[Node]:
    offset = subtract(vec(light.position), point)
    squared = dot(offset, offset)
    inverse = 1.0 / np.sqrt(squared)
    axis = to_frame(scale(offset, inverse), frame)
    side, other = basis(axis)
    sine_squared = np.minimum(np.float32(light.radius**2) / squared, np.float32(1.0))
    # 1 - cos of the cone's half angle, without cancellation for small lights.
    opening = sine_squared / (1.0 + np.sqrt(1.0 - sine_squared))
    distance = np.maximum(1.0 / inverse - np.float32(light.radius), np.float32(0.0))
    for u, c, s, weight, cell in zip(*rule.places, rule.weights, rule.cell, strict=True):
        drop = opening * np.float32(u)
        cosine = 1.0 - drop
        sine = np.sqrt(drop * (1.0 + cosine))
        received = opening * np.float32(weight)
        rim = add(scale(side, float(c)), scale(other, float(s)))
        yield Node(add(scale(axis, cosine), scale(rim, sine)), received, distance, int(cell))
