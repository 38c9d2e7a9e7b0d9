"""Inner functions of the C loops of relighting, called on arrays."""

from ctypes import byref, c_int64

import numpy as np

from matcap.relight.camera import Array, Vec, dot, scale
from matcap.relight.environment_map import Octahedra
from matcap.relight.loops.library import KeptArrays, Pointer, address, loops
from matcap.relight.relief import Relief


def unit(vector: Vec) -> Vec:
    """Of length 1; a zero vector stays zero."""
    return scale(vector, 1.0 / np.sqrt(np.maximum(dot(vector, vector), np.float32(1e-30))))


def lobe(normal: Vec, to_view: Vec, to_light: Vec, alpha: Array) -> tuple[Array, Array]:
    """D G / (4 (n.l)(n.v)) in 1/sr for cosines above 0, and (1 - l.h)^5; (N,) arrays."""
    kept, count = KeptArrays(), alpha.size
    values, weight = np.empty((2, count), dtype=np.float32)
    vectors = (Pointer(kept.of(np.stack(one))) for one in (normal, to_view, to_light))
    loops().matcap_relight_lobe(
        c_int64(count), *vectors, Pointer(kept.of(alpha)), address(values), address(weight)
    )
    return values, weight


def lit(
    relief: Relief, place: tuple[Array, Array], height: Array, to_light: Vec,
    distance: Array | None,
) -> Array:  # fmt: skip
    """Whether light arrives at places (u, v) in plane units; `distance` None is infinite."""
    shape = np.broadcast_shapes(*(a.shape for a in (*place, height, *to_light)))
    kept, visible = KeptArrays(), np.empty(shape, dtype=np.uint8)

    def every(values: Array, dtype: type = np.float32) -> Pointer:
        return Pointer(kept.of(np.broadcast_to(values, shape), dtype))

    column, row = relief.texels(*place)
    loops().matcap_relight_lit(
        byref(relief.field), c_int64(visible.size), every(column, np.float64),
        every(row, np.float64), every(height), *(every(one) for one in to_light),
        None if distance is None else every(distance), address(visible),
    )  # fmt: skip
    return visible.astype(bool)


def radiance(octahedra: Octahedra, direction: Vec, wide: Array) -> Array:
    """(3, N) radiance along unit vectors, averaged over `wide` radians (root of a solid angle)."""
    kept, looked_up = KeptArrays(), np.empty((3, wide.size), dtype=np.float32)
    places = (Pointer(kept.of(one)) for one in (*direction, wide))
    loops().matcap_relight_radiance(
        byref(octahedra.as_c()), c_int64(wide.size), *places, address(looked_up)
    )
    return looked_up
