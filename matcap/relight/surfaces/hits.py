"""Where rays met a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.relight.vectors import Array, Vec


@dataclass(frozen=True)
class Hits:
    """A block of pixels' places on a surface; arrays broadcast to (rows, W).

    Attributes:
        point: in the scene.
        frame: tangent, bitangent and normal of the material there, unit vectors of the scene;
            None where the material lies in the scene's own plane, x right and y up.
        place: (u, v) on the material in plane units, the origin in its middle.
        to_view: unit vector to the camera, in the material's frame.
        seen: (rows, W) False where the ray misses; None where all rays hit.
        footprint: what a pixel covers, in plane units along the longer and the shorter axis.
    """

    point: Vec
    frame: tuple[Vec, Vec, Vec] | None
    place: tuple[Array, Array]
    to_view: Vec
    seen: NDArray[np.bool_] | None
    footprint: Array
