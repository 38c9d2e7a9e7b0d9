"""Surfaces of scenes: the plane, and which shape a scene asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from matcap.relight.camera import View
from matcap.relight.relief import Relief
from matcap.relight.scene import Film, Surface
from matcap.relight.scene_bounds import VisibleRegion
from matcap.relight.surfaces.curved import Round
from matcap.relight.surfaces.hits import Hits, Shape
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array, Vec, dot, scale, subtract, vec


@dataclass(frozen=True)
class Flat(Shape):
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


def shape_of(surface: Surface, texture: Texture) -> Shape:
    """The shape of a surface; reads a mesh's file.

    Raises:
        MatcapError: as load_mesh.
    """
    width, height = (side / surface.repeat for side in texture.extent)
    if surface.type == "plane":
        size = surface.size
        return Flat((width, height) if size is None else (size, size))
    radius = (surface.size or max(width, height)) / 2.0
    if surface.type == "mesh":
        from matcap.relight.surfaces.mesh import load_mesh

        assert surface.file is not None
        return load_mesh(surface.file, 2.0 * radius)
    return Round(radius, surface.type == "cylinder")
