"""Surfaces of scenes: plane, sphere and cylinder."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from matcap.relight.block import Hits, to_frame
from matcap.relight.camera import Array, Vec, View, dot, scale, subtract, vec
from matcap.relight.plan import VisibleRegion
from matcap.relight.relief import Relief
from matcap.relight.scene import Film, Surface
from matcap.relight.texture import Texture

# Sphere and cylinder around the origin, seen from outside.
#
# (u, v) = (radius longitude, radius latitude or y), with 0 at +z: true to size on the equator,
# squeezed towards a sphere's poles. The cylinder is upright and open. Displacement moves lookups in
# the tangent plane; outlines stay smooth.

# Picture's short side over a curved surface's diameter, with the default camera.
_MARGIN = 1.25


@dataclass(frozen=True)
class Round:
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
        frame = (_vec(tangent), _vec(bitangent), _vec(normal))
        to_view = to_frame(_vec(-direction), frame)
        pixel = view.pixel * (along if view.perspective else np.ones_like(along))
        footprint = (pixel / np.maximum(to_view[2], 1e-3)).astype(np.float32)
        # Rays that miss look up the middle of the material: any valid place.
        place = (np.where(seen, self.radius * longitude, 0.0), np.where(seen, up, 0.0))
        footprint = np.where(seen, footprint, np.float32(0.0))
        return Hits(_vec(point), frame, place, to_view, seen, footprint)

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points; footprints are unbounded towards the outline."""
        r = self.radius + max(abs(relief.low), abs(relief.high))
        return VisibleRegion((-r, -r, -r), (r, r, r), flat=False), math.inf


def _nearest(a: Array, half_b: Array, c: Array) -> tuple[Array, Array]:
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


@dataclass(frozen=True)
class Flat:
    """The plane z = 0, `extent` wide and high."""

    extent: tuple[float, float]

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        return max(self.extent)

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        if _frontal(view):
            distance = view.position[2] if view.perspective else 1.0
            across, down = view.screen(top, bottom)
            x = across * distance + view.position[0]
            y = down * distance + view.position[1]
            ahead = view.position[2] > 0.0
        else:
            origin, direction = view.rays(top, bottom)
            falling = direction[2] < -1e-9
            along = np.where(falling, -origin[2] / np.where(falling, direction[2], -1.0), -1.0)
            ahead = along > 0.0
            x, y = (np.where(ahead, origin[i] + along * direction[i], 0.0) for i in (0, 1))
        # Pixel centres on the border are inside.
        half_width, half_height = (side / 2.0 * (1.0 + 1e-9) for side in self.extent)
        seen = np.asarray(ahead) & (np.abs(x) <= half_width) & (np.abs(y) <= half_height)
        shape = (bottom - top, view.across[1] - view.across[0])
        point = (x.astype(np.float32), y.astype(np.float32), np.zeros((1, 1), dtype=np.float32))
        to_view, footprint = _seen_from(view, point)
        return Hits(
            point=point,
            frame=None,
            place=(x, y),
            to_view=to_view,
            seen=None if seen.all() else np.broadcast_to(seen, shape),
            footprint=footprint,
        )

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points, and the largest side of a pixel's footprint."""
        high = [side / 2.0 for side in self.extent]
        low = [-side for side in high]
        endless = Flat((math.inf, math.inf))
        rows = [endless.hits(view, row, row + 1) for row in (0, view.size[1] - 1)]
        if all(hits.seen is None for hits in rows):
            # The picture's rays fill a convex part of the plane: its corners bound it.
            for axis in (0, 1):
                places = [float(hits.place[axis].ravel()[i]) for hits in rows for i in (0, -1)]
                slack = 1e-6 * (high[axis] - low[axis])
                low[axis] = min(max(low[axis], min(places) - slack), high[axis])
                high[axis] = max(min(high[axis], max(places) + slack), low[axis])
        region = VisibleRegion((low[0], low[1], relief.low), (high[0], high[1], relief.high), True)
        if view.perspective and not _frontal(view):
            above = view.position[2]
            far = max(
                sum((np.array([x, y, 0.0]) - view.position) ** 2)
                for x in (low[0], high[0])
                for y in (low[1], high[1])
            )
            return region, float(view.pixel * far / above) if above > 0.0 else 0.0
        return region, float(rows[0].footprint.max())


def _seen_from(view: View, point: Vec) -> tuple[Vec, Array]:
    """Unit vectors from points of the plane to the camera, and sides of pixels' footprints."""
    if not view.perspective:
        x, y, z = (np.full((1, 1), c, dtype=np.float32) for c in -view.axes[2])
        return (x, y, z), np.full((1, 1), view.pixel / max(-view.axes[2][2], 1e-6), np.float32)
    offset = subtract(vec(tuple(view.position)), point)
    inverse = 1.0 / np.sqrt(dot(offset, offset))
    to_view = scale(offset, inverse)
    if _frontal(view):
        # The plane is parallel to the picture: one footprint for all pixels.
        return to_view, np.full((1, 1), view.pixel * view.position[2], dtype=np.float32)
    return to_view, view.pixel / inverse / np.maximum(to_view[2], np.float32(1e-6))


def _frontal(view: View) -> bool:
    """Whether the camera looks straight down, with the picture's sides along x and y."""
    return bool(np.abs(view.axes - np.diag([1.0, 1.0, -1.0])).max() < 1e-12)


def shape_of(surface: Surface, texture: Texture) -> Flat | Round:
    """The shape of a surface."""
    width, height = (side / surface.repeat for side in texture.extent)
    if surface.type == "plane":
        size = surface.size
        return Flat((width, height) if size is None else (size, size))
    return Round((surface.size or max(width, height)) / 2.0, surface.type == "cylinder")
