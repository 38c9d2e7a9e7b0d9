"""Interface of surfaces: ray intersections, and bounds of the visible region."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from matcap.relight.camera import View
from matcap.relight.relief import Relief
from matcap.relight.scene import Film, Surface
from matcap.relight.scene_bounds import VisibleRegion
from matcap.relight.surfaces.curved import cylinder_hits, sphere_hits
from matcap.relight.surfaces.hits import Hits
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array, Vec, dot, scale, subtract, vec

# Picture's short side over a curved surface's diameter, with the default camera.
_MARGIN = 1.25


class Shape(Protocol):
    """A surface in the scene."""

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, in plane units."""

    def seen_by(self, view: View) -> Shape:
        """This shape, prepared for a view: a mesh rasterises the face that each pixel sees."""

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows."""

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points, and the largest side of a pixel's footprint."""


@dataclass(frozen=True)
class Flat:
    """The plane z = 0, `extent` wide and high."""

    extent: tuple[float, float]

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        return max(self.extent)

    def seen_by(self, view: View) -> Shape:
        """This shape, prepared for a view."""
        return self

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        return plane_hits(view, top, bottom, self.extent)

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points, and the largest side of a pixel's footprint."""
        return plane_region(view, self.extent, (relief.low, relief.high))


@dataclass(frozen=True)
class Round:
    """A sphere, or an upright cylinder as high as it is wide."""

    radius: float
    cylinder: bool

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        sides = max(film.width, film.height) / min(film.width, film.height)
        return 2.0 * self.radius * _MARGIN * sides

    def seen_by(self, view: View) -> Shape:
        """This shape, prepared for a view."""
        return self

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        if self.cylinder:
            return cylinder_hits(view, top, bottom, self.radius, 2.0 * self.radius)
        return sphere_hits(view, top, bottom, self.radius)

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points; footprints are unbounded towards the outline."""
        r = self.radius + max(abs(relief.low), abs(relief.high))
        return VisibleRegion((-r, -r, -r), (r, r, r), flat=False), math.inf


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


def plane_hits(
    view: View, top: int, bottom: int, extent: tuple[float, float] | None = None
) -> Hits:
    """Intersect the rays of rows with the plane.

    Args:
        top, bottom: rows of the picture, half open.
        extent: (width, height) outside which there is nothing.
    """
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
    seen = np.asarray(ahead)
    if extent is not None:
        # Pixel centres on the border are inside.
        slack = 1.0 + 1e-9
        inside_x = np.abs(x) <= extent[0] / 2.0 * slack
        inside_y = np.abs(y) <= extent[1] / 2.0 * slack
        seen = seen & inside_x & inside_y
    all_seen = bool(seen.all())
    shape = (bottom - top, view.across[1] - view.across[0])
    point = (x.astype(np.float32), y.astype(np.float32), np.zeros((1, 1), dtype=np.float32))
    footprint: Array
    to_view: Vec
    if view.perspective:
        offset = subtract(vec(tuple(view.position)), point)
        squared = dot(offset, offset)
        inverse = 1.0 / np.sqrt(squared)
        to_view = scale(offset, inverse)
        if _frontal(view):
            # The plane is parallel to the picture: one footprint for all pixels.
            footprint = np.full((1, 1), view.pixel * view.position[2], dtype=np.float32)
        else:
            footprint = view.pixel / inverse / np.maximum(to_view[2], np.float32(1e-6))
    else:
        x_view, y_view, z_view = (np.full((1, 1), c, dtype=np.float32) for c in -view.axes[2])
        to_view = (x_view, y_view, z_view)
        footprint = np.full((1, 1), view.pixel / max(-view.axes[2][2], 1e-6), dtype=np.float32)
    return Hits(
        point=point,
        frame=None,
        place=(x, y),
        to_view=to_view,
        seen=None if all_seen else np.broadcast_to(seen, shape),
        footprint=footprint,
    )


def _frontal(view: View) -> bool:
    """Whether the camera looks straight down, with the picture's sides along x and y."""
    return bool(np.abs(view.axes - np.diag([1.0, 1.0, -1.0])).max() < 1e-12)


def plane_region(
    view: View, extent: tuple[float, float], relief: tuple[float, float]
) -> tuple[VisibleRegion, float]:
    """Bounding box of the visible points, and the largest side of a pixel's footprint.

    Args:
        extent: (width, height) of the plane, in plane units.
        relief: lowest and highest displacing height, in plane units.
    """
    low = [-extent[0] / 2.0, -extent[1] / 2.0]
    high = [extent[0] / 2.0, extent[1] / 2.0]
    height = view.size[1]
    corners = [plane_hits(view, row, row + 1) for row in (0, height - 1)]
    if all(hits.seen is None for hits in corners):
        # The picture's rays fill a convex part of the plane: its corners bound it.
        for axis in (0, 1):
            places = [float(h.place[axis].ravel()[i]) for h in corners for i in (0, -1)]
            slack = 1e-6 * (high[axis] - low[axis])
            low[axis] = min(max(low[axis], min(places) - slack), high[axis])
            high[axis] = max(min(high[axis], max(places) + slack), low[axis])
    region = VisibleRegion((low[0], low[1], relief[0]), (high[0], high[1], relief[1]), flat=True)
    if view.perspective and not _frontal(view):
        above = view.position[2]
        far = max(
            sum((np.array([x, y, 0.0]) - view.position) ** 2)
            for x in (low[0], high[0])
            for y in (low[1], high[1])
        )
        return region, float(view.pixel * far / above) if above > 0.0 else 0.0
    return region, float(corners[0].footprint.max())
