"""Parallax and masking: the height moves what a camera sees, and hides what lies behind.

A ray is followed through the height field from its top downwards in steps of at most half a texel
until it is below the surface, then the crossing is found by the secant rule (relief mapping:
Policarpo et al. 2005). A ridge thinner than half a texel of its path may be missed: the bilinear
surface has none thinner than a texel. Curved surfaces are followed in their tangent plane; the
outline of the surface stays that of the undisplaced one.

Left out: the surface is shaded where its undisplaced form stands. Cost: four texels a step, two
steps a texel of shift.
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

# Texels around a place on a ray whose highest says how many steps can be left out.
_AROUND = 10
# z of the flattest ray that is followed; steps of a ray at least, at most, and a texel of its path.
_LOWEST, _LEAST, _MOST, _DENSITY = 0.05, 8.0, 512.0, 3.0


def bound(limits: SceneBounds) -> Bound:
    """Nothing on a flat surface; on another, whatever the picture shows."""
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    return Bound(limits.everything, f"relief of {limits.relief:.2g} moves what is seen")


def shift(
    relief: Relief, place: tuple[Array, Array], to_view: Vec
) -> tuple[tuple[Array, Array], Array]:
    """Where rays through `place` on the undisplaced surface meet the displaced one.

    Each takes as many steps as it needs itself, wherever in the picture it is, and leaves out
    those on which it is above all texels around.

    Args:
        relief: the height field.
        place: (u, v) in plane units.
        to_view: unit vectors to the camera in the material's frame.

    Returns:
        (u, v) there and the height there, arrays of one shape.
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
    """Hits on the displaced surface, and the height there."""
    (u, v), height = shift(relief, hits.place, hits.to_view)
    moved = (
        (u - hits.place[0]).astype(np.float32),
        (v - hits.place[1]).astype(np.float32),
        height,
    )
    return replace(hits, point=add(hits.point, to_scene(moved, hits.frame)), place=(u, v)), height
