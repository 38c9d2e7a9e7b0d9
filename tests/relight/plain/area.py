"""Lights with a size, point by point, plainly: what matcap.relight.loops is held to."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from matcap.relight.block import TangentFrame, to_frame
from matcap.relight.camera import Array, Vec, add, dot, scale, subtract, vec
from matcap.relight.effects.area import _DENSITY, ORDERS, AreaLight, Rule, _axes, _half
from matcap.relight.scene import RectangleLight, SphereLight
from plain.visible_normals import basis


@dataclass(frozen=True)
class Node:
    """One point of a light, seen from each pixel of a block."""

    to_light: Vec
    """Unit vector in the material's frame."""
    received: Array
    """Irradiance on a surface facing it, for radiance 1."""
    distance: Array
    """Distance to the light."""
    cell: int
    """Index of the light's part in which the point lies."""


def nodes(light: AreaLight, rule: Rule, point: Vec, frame: TangentFrame | None) -> Iterator[Node]:
    """The points of a rule, seen from the pixels of a block."""
    seen = _sphere if isinstance(light, SphereLight) else _rectangle
    yield from seen(light, rule, point, frame)  # type: ignore[arg-type]


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


def orders(light: AreaLight, point: Vec, alpha: Array) -> Array:
    """Points along a side of the rule that each pixel needs wherever its lobe points; 0 for none.

    Args:
        light: the light.
        point: pixels' places in the scene.
        alpha: GGX's.
    """
    offset, half = subtract(vec(light.position), point), np.float32(_half(light))
    distance = np.sqrt(dot(offset, offset))
    angle = np.arctan2(half, np.maximum(distance - half, np.float32(1e-6)))
    needed = 3.0 + np.ceil(_DENSITY * angle / (2.0 * np.maximum(alpha, 1e-6)) + 6.0 * angle)
    return np.array([*ORDERS, 0])[np.searchsorted(ORDERS, needed)]
