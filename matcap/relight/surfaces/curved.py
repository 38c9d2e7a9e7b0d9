"""Sphere and cylinder around the origin, seen from outside.

(u, v) = (radius longitude, radius latitude or y), with 0 at +z: true to size on the equator,
squeezed towards a sphere's poles. The cylinder is upright and open. Displacement moves lookups in
the tangent plane; outlines stay smooth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from matcap.relight.camera import View
from matcap.relight.surfaces.hits import Hits, TangentFrame, to_frame
from matcap.relight.vectors import Array, Vec


def sphere_hits(view: View, top: int, bottom: int, radius: float) -> Hits:
    """Intersect the rays of rows with a sphere."""
    origin, direction = view.rays(top, bottom)
    along, seen = _nearest(
        (direction * direction).sum(0),
        (origin * direction).sum(0),
        (origin * origin).sum(0) - radius**2,
    )
    point = origin + along * direction
    normal = point / np.maximum(np.sqrt((point * point).sum(0)), 1e-30)
    longitude = np.arctan2(normal[0], normal[2])
    latitude = np.arcsin(np.clip(normal[1], -1.0, 1.0))
    zero = np.zeros_like(longitude)
    tangent = np.stack([np.cos(longitude), zero, -np.sin(longitude)])
    bitangent = np.cross(normal, tangent, axis=0)
    place = radius * longitude, radius * latitude
    frame = frame_of(tangent, bitangent, normal)
    return hits_of(view, point, frame, place, seen, along, direction)


def cylinder_hits(view: View, top: int, bottom: int, radius: float, height: float) -> Hits:
    """Intersect the rays of rows with an upright cylinder's outside."""
    origin, direction = view.rays(top, bottom)
    flat_o, flat_d = origin * [[[1.0]], [[0.0]], [[1.0]]], direction * [[[1.0]], [[0.0]], [[1.0]]]
    along, seen = _nearest(
        (flat_d * flat_d).sum(0), (flat_o * flat_d).sum(0), (flat_o * flat_o).sum(0) - radius**2
    )
    point = origin + along * direction
    seen = seen & (np.abs(point[1]) <= height / 2.0)
    longitude = np.arctan2(point[0], point[2])
    zero, one = np.zeros_like(longitude), np.ones_like(longitude)
    sine, cosine = np.sin(longitude), np.cos(longitude)
    frame = frame_of(
        np.stack([cosine, zero, -sine]), np.stack([zero, one, zero]), np.stack([sine, zero, cosine])
    )
    place = radius * longitude, point[1]
    return hits_of(view, point, frame, place, seen, along, direction)


def hits_of(
    view: View,
    point: Array,
    frame: TangentFrame,
    place: tuple[Array, Array],
    seen: Array,
    along: Array,
    direction: Array,
) -> Hits:
    """Hits of rays on a curved surface.

    Args:
        point: (3, rows, W) intersections.
        frame: tangent, bitangent, normal.
        place: (u, v) on the material, (rows, W).
        seen: (rows, W) False where rays miss.
        along: (rows, W) distances along the rays.
        direction: (3, rows, W) unit vectors of the rays.
    """
    to_view = to_frame(_vec(-direction), frame)
    pixel = view.pixel * (along if view.perspective else np.ones_like(along))
    footprint = (pixel / np.maximum(to_view[2], 1e-3)).astype(np.float32)
    # Rays that miss look up the middle of the material: any valid place.
    place = tuple(np.where(seen, p, 0.0) for p in place)  # type: ignore[assignment]
    footprint = np.where(seen, footprint, np.float32(0.0))
    return Hits(_vec(point), frame, place, to_view, np.asarray(seen), footprint)


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


def frame_of(tangent: Array, bitangent: Array, normal: Array) -> TangentFrame:
    """The frame of (3, ...) unit vectors, in float32."""
    return _vec(tangent), _vec(bitangent), _vec(normal)
