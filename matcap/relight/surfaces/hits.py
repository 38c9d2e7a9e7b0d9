"""Ray-surface intersections, and the interface of surfaces."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from matcap.relight.camera import View
from matcap.relight.relief import Relief
from matcap.relight.scene import Film
from matcap.relight.scene_bounds import VisibleRegion
from matcap.relight.vectors import Array, Vec, add, dot, scale

TangentFrame = tuple[Vec, Vec, Vec]


@dataclass(frozen=True)
class Hits:
    """Intersections of a block of pixels; arrays broadcast to (rows, W)."""

    point: Vec
    """Position in the scene."""
    frame: TangentFrame | None
    """Tangent, bitangent and normal of the undisplaced surface, unit vectors of the scene; None on
    the plane, where they are x, y and z."""
    place: tuple[Array, Array]
    """(u, v) on the material in plane units, (0, 0) in its middle."""
    to_view: Vec
    """Unit vector to the camera, in the material's frame."""
    seen: Array | None
    """(rows, W) False where the ray misses; None where all rays hit."""
    footprint: Array
    """Longer side of a pixel's footprint, in plane units."""

    def flat(self, index: Array | None, shape: tuple[int, ...]) -> Hits:
        """Flatten to (N,) arrays, row by row.

        Args:
            index: flat indices of the pixels to keep; None keeps all.
            shape: (rows, W) of the block.
        """

        def every(array: Array) -> Array:
            whole = np.broadcast_to(array, shape)
            return whole.ravel() if index is None else whole.reshape(-1)[index]

        def vector(one: Vec) -> Vec:
            return every(one[0]), every(one[1]), every(one[2])

        frame = self.frame and (vector(self.frame[0]), vector(self.frame[1]), vector(self.frame[2]))
        place = (every(self.place[0]), every(self.place[1]))
        footprint = every(self.footprint)
        return Hits(vector(self.point), frame, place, vector(self.to_view), None, footprint)


class Shape(ABC):
    """A surface in the scene."""

    @abstractmethod
    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, in plane units."""

    def seen_by(self, view: View) -> Shape:
        """This shape, prepared for a view: a mesh rasterises the face that each pixel sees."""
        return self

    @abstractmethod
    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""

    @abstractmethod
    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points, and the largest side of a pixel's footprint."""


def to_frame(vector: Vec, frame: TangentFrame | None) -> Vec:
    """A vector of the scene in the tangent frame."""
    if frame is None:
        return vector
    return dot(vector, frame[0]), dot(vector, frame[1]), dot(vector, frame[2])


def to_scene(vector: Vec, frame: TangentFrame | None) -> Vec:
    """A vector of the tangent frame in the scene."""
    if frame is None:
        return vector
    x, y, z = (scale(axis, c) for axis, c in zip(frame, vector, strict=True))
    return add(add(x, y), z)
