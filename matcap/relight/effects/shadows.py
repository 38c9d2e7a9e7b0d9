"""Shadows that the height field casts on itself.

Along the way to a light the ray is compared with the surface wherever it crosses a line between
texel centres, the lines of columns and then those of rows: on such a line the bilinear surface is
piecewise linear, so the test is exact there. Between lines the surface may bulge by a quarter of
the cell's twist |h00 + h11 - h01 - h10|, which is the error. The ray ends at the height field's
top or at the light. The material is taken to go on beyond the border of the surface; other parts
of a curved surface cast no shadow but by facing away.

Left out: nothing but the surface's own facing away hides a light. Cost: two texels a crossing,
and as many crossings as texels that the shadow of the highest point may reach.
"""

from __future__ import annotations

import math
from ctypes import byref, c_int64
from typing import Any

import numpy as np

from matcap.relight.effects.bound import Bound
from matcap.relight.loops.library import KeptArrays, Pointer, address, loops
from matcap.relight.relief import Relief
from matcap.relight.scene_bounds import SceneBounds
from matcap.relight.vectors import Array, Vec


def bound(limits: SceneBounds) -> Bound:
    """No height field whose slope stays below s shadows a light whose elevation has tan >= s."""
    if not limits.lights:
        return Bound(0.0, "no light casts shadows")
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    slope = limits.relief_slope
    low = [light for light in limits.lights if light.tangent < slope]
    steepest = math.degrees(math.atan(slope))
    lowest = math.degrees(math.atan(min(light.tangent for light in limits.lights)))
    reason = f"lowest light at {lowest:.3g} degrees, steepest slope {steepest:.3g}"
    if not low:
        return Bound(0.0, reason)
    return Bound(sum(limits.radiance(light) for light in low), reason)


def lit(
    relief: Relief,
    place: tuple[Array, Array],
    height: Array,
    to_light: Vec,
    distance: Array | None,
) -> Array:
    """Whether light arrives, for each of some places.

    Args:
        relief: the height field.
        place: (u, v) in plane units, and
        height: the surface there.
        to_light: unit vectors in the material's frame.
        distance: to the light; None when it is infinitely far.
    """
    shape = np.broadcast_shapes(*(a.shape for a in (*place, height, *to_light)))
    kept, visible = KeptArrays(), np.empty(shape, dtype=np.uint8)

    def every(values: Array, dtype: type = np.float32) -> Any:  # noqa: ANN401
        return Pointer(kept.of(np.broadcast_to(values, shape), dtype))

    column, row = relief.texels(*place)
    loops().matcap_relight_lit(
        byref(relief.field), c_int64(visible.size), every(column, np.float64),
        every(row, np.float64), every(height), *(every(one) for one in to_light),
        None if distance is None else every(distance), address(visible),
    )  # fmt: skip
    return visible.astype(bool)
