"""The C loops of relighting, called for a point light in another direction from each pixel."""

from __future__ import annotations

from ctypes import byref

import numpy as np

from matcap.relight.loops.library import KeptArrays, address, loops
from matcap.relight.loops.structures import SPECULAR, CLamp, CPixels
from matcap.relight.relief import Relief
from matcap.relight.vectors import Array, Vec, dot, scale

_FAR = 1e4  # plane units: light from here is parallel


def unit(vector: Vec) -> Vec:
    """Of length 1; a zero vector stays zero."""
    return scale(vector, 1.0 / np.sqrt(np.maximum(dot(vector, vector), np.float32(1e-30))))


def lobe(normal: Vec, to_view: Vec, to_light: Vec, alpha: Array) -> tuple[Array, Array]:
    """D G / (4 (n.l)(n.v)) in 1/sr for cosines above 0, and (1 - l.h)^5; (N,) arrays."""
    kept, cosine = KeptArrays(), dot(normal, to_light)
    # F0 of 1 and of 0: radiance is lobe n.l, and that times Schlick's weight.
    f0, total = np.zeros((3, alpha.size), np.float32), np.zeros((3, alpha.size), np.float32)
    f0[0] = 1.0
    pixels = CPixels(
        count=alpha.size,
        point=tuple(kept.of(-one) for one in to_light),
        view=tuple(kept.of(one) for one in to_view),
        normal=tuple(kept.of(one) for one in normal),
        n_dot_v=kept.of(np.maximum(dot(normal, to_view), 0.0)),
        alpha=kept.of(alpha),
        diffuse=tuple(kept.of(one) for one in f0),
        specular=tuple(kept.of(one) for one in f0),
        total=tuple(one.ctypes.data for one in total),
    )
    lamp = CLamp(colour=(1.0, 1.0, 1.0), power=1.0, even=1.0, parts=SPECULAR)
    loops().matcap_relight_lamp(byref(pixels), byref(lamp), None)
    lit = cosine > 0.0
    value = np.divide(total[0], cosine, out=np.zeros_like(cosine), where=lit)
    return value, np.divide(total[1], total[0], out=np.zeros_like(cosine), where=lit)


def lit(relief: Relief, place: tuple[Array, Array], to_light: Vec, distance: Array | None) -> Array:
    """Whether light arrives at the surface at places (u, v); `distance` None is infinite."""
    shape = np.broadcast_shapes(*(a.shape for a in (*place, *to_light)))
    kept, size = KeptArrays(), int(np.prod(shape))
    visible, cast = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)

    def every(values: Array, dtype: type = np.float32) -> int:
        return kept.of(np.broadcast_to(values, shape), dtype)

    column, row = relief.texels(*place)
    far = _FAR if distance is None else distance
    pixels = CPixels(
        count=size,
        column=every(column, np.float64),
        row=every(row, np.float64),
        point=tuple(every(-one * far) for one in to_light),
        normal=tuple(every(one) for one in to_light),
        facing=every(np.ones(1), np.uint8),
        wide=every(np.zeros(1)),
    )
    lamp = CLamp(power=1.0, even=1.0)
    loops().matcap_relight_past(
        byref(pixels), byref(lamp), byref(relief.field), None, address(visible), address(cast)
    )
    return visible > 0.5
