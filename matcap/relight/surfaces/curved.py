"""Sphere and cylinder around the origin, seen from outside.

(u, v) = (radius longitude, radius latitude or y), with 0 at +z: true to size on the equator,
squeezed towards a sphere's poles. The cylinder is upright and open. Displacement moves lookups in
the tangent plane; outlines stay smooth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from matcap.relight.camera import View
from matcap.relight.relief import Relief
from matcap.relight.scene import Film
from matcap.relight.scene_bounds import VisibleRegion
from matcap.relight.surfaces.hits import Hits, Shape, to_frame
from matcap.relight.vectors import Array, Vec

# Picture's short side over a curved surface's diameter, with the default camera.
_MARGIN = 1.25


@dataclass(frozen=True)
class Round(Shape):
    """A sphere, or an upright cylinder as high as it is wide."""

    radius: float
    cylinder: bool

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        sides = max(film.width, film.height) / min(film.width, film.height)
        return 2.0 * self.radius * _MARGIN * sides

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        origin, direction = view.rays(top, bottom)
        # Seen along y, a cylinder is a circle.
        axes = np.array([1.0, 0.0 if self.cylinder else 1.0, 1.0])[:, None, None]
        o, d = origin * axes, direction * axes
        along, seen = _nearest((d * d).sum(0), (o * d).sum(0), (o * o).sum(0) - self.radius**2)
        point = origin + along * direction
        if self.cylinder:
            seen = seen & (np.abs(point[1]) <= self.radius)
            longitude, up = np.arctan2(point[0], point[2]), point[1]
            zero = np.zeros_like(longitude)
            sine, cosine = np.sin(longitude), np.cos(longitude)
            tangent, normal = np.stack([cosine, zero, -sine]), np.stack([sine, zero, cosine])
            bitangent = np.stack([zero, zero + 1.0, zero])
        else:
            normal = point / np.maximum(np.sqrt((point * point).sum(0)), 1e-30)
            longitude = np.arctan2(normal[0], normal[2])
            up = self.radius * np.arcsin(np.clip(normal[1], -1.0, 1.0))
            zero = np.zeros_like(longitude)
            tangent = np.stack([np.cos(longitude), zero, -np.sin(longitude)])
            bitangent = np.cross(normal, tangent, axis=0)
        frame, place = (tangent, bitangent, normal), (self.radius * longitude, up)
        return hits_of(view, point, frame, place, seen, along, direction)

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points; footprints are unbounded towards the outline."""
        r = self.radius + max(abs(relief.low), abs(relief.high))
        return VisibleRegion((-r, -r, -r), (r, r, r), flat=False), math.inf


def hits_of(
    view: View,
    point: Array,
    axes: tuple[Array, Array, Array],
    place: tuple[Array, Array],
    seen: Array,
    along: Array,
    direction: Array,
) -> Hits:
    """Hits of rays on a curved surface.

    Args:
        point: (3, rows, W) intersections.
        axes: tangent, bitangent and normal there, (3, rows, W) unit vectors.
        place: (u, v) on the material, (rows, W).
        seen: (rows, W) False where rays miss.
        along: (rows, W) distances along the rays.
        direction: (3, rows, W) unit vectors of the rays.
    """
    frame = (_vec(axes[0]), _vec(axes[1]), _vec(axes[2]))
    to_view = to_frame(_vec(-direction), frame)
    pixel = view.pixel * (along if view.perspective else np.ones_like(along))
    footprint = (pixel / np.maximum(to_view[2], 1e-3)).astype(np.float32)
    # Rays that miss look up the middle of the material: any valid place.
    u, v = (np.where(seen, one, 0.0) for one in place)
    footprint = np.where(seen, footprint, np.float32(0.0))
    return Hits(_vec(point), frame, (u, v), to_view, np.asarray(seen), footprint)


def _nearest(a: Array, half_b: Array, c: Array) -> tuple[Array, Any]:
    """The smaller root of a t^2 + 2 half_b t + c = 0, and where it is real and positive."""
    inside = half_b * half_b - a * c
    seen = (inside > 0.0) & (a > 1e-12)
    safe = np.where(seen, a, 1.0)
    along = (-half_b - np.sqrt(np.maximum(inside, 0.0))) / safe
    seen = seen & (along > 0.0)
    return np.where(seen, along, 1.0), seen


def _vec(array: Array) -> Vec:
    x, y, z = array.astype(np.float32)
    return x, y, z
