"""Ray-surface intersections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from matcap.relight.vectors import Array, Vec, add, dot, scale

TangentFrame = tuple[Vec, Vec, Vec]


@dataclass(frozen=True)
class Hits:
    """A block of pixels' places on a surface; arrays broadcast to (rows, W)."""

    point: Vec
    """In the scene."""
    frame: TangentFrame | None
    """Tangent, bitangent and normal of the material there, unit vectors of the scene; None where
    the material lies in the scene's own plane, x right and y up."""
    place: tuple[Array, Array]
    """(u, v) on the material in plane units, the origin in its middle."""
    to_view: Vec
    """Unit vector to the camera, in the material's frame."""
    seen: Array | None
    """(rows, W) False where the ray misses; None where all rays hit."""
    footprint: Array
    """What a pixel covers, in plane units along the longer and the shorter axis."""

    def flat(self, index: Array | None, shape: tuple[int, ...]) -> Hits:
        """Pixels of a block of some shape, all or some, row by row: (N,) arrays, all hit."""

        def every(array: Array) -> Array:
            whole = np.broadcast_to(array, shape)
            flattened: Array = whole.ravel() if index is None else whole.reshape(-1)[index]
            return flattened

        def vector(one: Vec) -> Vec:
            return every(one[0]), every(one[1]), every(one[2])

        frame = self.frame and (vector(self.frame[0]), vector(self.frame[1]), vector(self.frame[2]))
        place = (every(self.place[0]), every(self.place[1]))
        footprint = every(self.footprint)
        return Hits(vector(self.point), frame, place, vector(self.to_view), None, footprint)


def to_frame(vector: Vec, frame: TangentFrame | None) -> Vec:
    """A vector of the scene in the material's frame."""
    if frame is None:
        return vector
    return dot(vector, frame[0]), dot(vector, frame[1]), dot(vector, frame[2])


def to_scene(vector: Vec, frame: TangentFrame | None) -> Vec:
    """A vector of the material's frame in the scene."""
    if frame is None:
        return vector
    x, y, z = (scale(axis, c) for axis, c in zip(frame, vector, strict=True))
    return add(add(x, y), z)
