"""Interface of surfaces: ray intersections, and bounds of the visible region."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from matcap.relight.camera import View
from matcap.relight.relief import Relief
from matcap.relight.scene import Film, Surface
from matcap.relight.scene_bounds import VisibleRegion
from matcap.relight.surfaces.curved import cylinder_hits, sphere_hits
from matcap.relight.surfaces.flat import plane_hits, plane_region
from matcap.relight.surfaces.hits import Hits
from matcap.relight.texture import Texture

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
