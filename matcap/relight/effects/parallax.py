"""Parallax and occlusion of the view by the height field: relief mapping [policarpo2005].

A ray descends from the top of the height field in steps of at most half a texel until it is below
the surface; the secant rule then gives the crossing. A ridge that the ray crosses in less than half
a texel may be missed. On curved surfaces rays run in the tangent plane; outlines stay those of the
undisplaced surface.

Left out: the undisplaced surface. Cost: four texels a step, two steps a texel of displacement.
"""

from __future__ import annotations

from ctypes import byref, c_int64
from dataclasses import replace

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.loops.library import KeptArrays, Pointer, address, loops
from matcap.relight.loops.structures import CSearch
from matcap.relight.relief import Relief
from matcap.relight.scene_bounds import SceneBounds
from matcap.relight.surfaces.hits import Hits, to_scene
from matcap.relight.vectors import Array, Vec, add

# Half side, in texels, of the maximum filter that lets rays skip empty space.
_AROUND = 10
# Smallest z of a ray's unit vector; least and largest number of steps, and steps a texel.
_LOWEST, _LEAST, _MOST, _DENSITY = 0.05, 8.0, 512.0, 3.0


def bound(limits: SceneBounds) -> Bound:
    """0 on a flat surface; else the picture's largest radiance."""
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    return Bound(
        limits.largest_radiance,
        f"heights of {limits.relief:.2g} shift texels",
    )


def shift(
    relief: Relief, place: tuple[Array, Array], to_view: Vec
) -> tuple[tuple[Array, Array], Array]:
    """Intersect view rays with the displaced surface.

    Args:
        place: (u, v) of the rays on the undisplaced surface, in plane units.
        to_view: unit vectors to the camera in the material's frame.

    Returns:
        (u, v) and height of the intersections, arrays of one shape.
    """
    shape = np.broadcast_shapes(place[0].shape, place[1].shape, to_view[2].shape)
    kept, height = KeptArrays(), np.empty(shape, dtype=np.float32)
    column, row = (
        np.array(np.broadcast_to(one, shape), dtype=np.float64) for one in relief.texels(*place)
    )
    search = CSearch(kept.of(relief.peaks(_AROUND)), _AROUND, _LOWEST, _MOST, _LEAST, _DENSITY)
    loops().matcap_relight_met(
        byref(relief.field), byref(search), c_int64(height.size), address(column), address(row),
        *(Pointer(kept.of(np.broadcast_to(one, shape))) for one in to_view), address(height),
    )  # fmt: skip
    width, rows = relief.texture.size
    u = (column - (width - 1) / 2.0) * relief.texel_size
    v = ((rows - 1) / 2.0 - row) * relief.texel_size
    return (u, v), height


def move(relief: Relief, hits: Hits) -> tuple[Hits, Array]:
    """Displace hits along their view rays; returns them and the height there."""
    (u, v), height = shift(relief, hits.place, hits.to_view)
    moved = (
        (u - hits.place[0]).astype(np.float32),
        (v - hits.place[1]).astype(np.float32),
        height,
    )
    return replace(hits, point=add(hits.point, to_scene(moved, hits.frame)), place=(u, v)), height
