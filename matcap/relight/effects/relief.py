"""Effects of the relief: parallax, filtering, self-shadowing, visibility, interreflection."""

from __future__ import annotations

import math
from ctypes import byref, c_int64
from dataclasses import replace
from typing import Any

import numpy as np

from matcap.relight.block import Block, Hits, to_scene
from matcap.relight.camera import Array, Vec, add
from matcap.relight.effects import Bound
from matcap.relight.loops.library import CSearch, KeptArrays, Pointer, Whole, address, loops
from matcap.relight.plan import SceneBounds
from matcap.relight.relief import COARSENESS, Relief

# Parallax and occlusion of the view by the height field: relief mapping [policarpo2005].
#
# A ray descends from the top of the height field in steps of at most half a texel until it is below
# the surface; the secant rule then gives the crossing. A ridge that the ray crosses in less than
# half a texel may be missed. On curved surfaces rays run in the tangent plane; outlines stay those
# of the undisplaced surface.
#
# Left out: the undisplaced surface. Cost: four texels a step, two steps a texel of displacement.

# Half side, in texels, of the maximum filter that lets rays skip empty space.
_AROUND = 10
# Smallest z of a ray's unit vector; least and largest number of steps, and steps a texel.
_LOWEST, _LEAST, _MOST, _DENSITY = 0.05, 8.0, 512.0, 3.0


def parallax_bound(limits: SceneBounds) -> Bound:
    """0 on a flat surface; else the picture's largest radiance."""
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    return Bound(limits.largest_radiance, f"heights of {limits.relief:.2g} shift texels")


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
    moved = ((u - hits.place[0]).astype(np.float32), (v - hits.place[1]).astype(np.float32), height)
    return replace(hits, point=add(hits.point, to_scene(moved, hits.frame)), place=(u, v)), height


# Texture filtering: maps averaged over a pixel, unresolved normals turned into roughness.
#
# Trilinear lookups in a mip pyramid [williams1983]. The variance of the slopes inside the footprint
# widens the lobe, alpha^2 + var(sx) + var(sy): LEAN mapping [olano2010], isotropic here. A distant
# bumpy mirror looks rough instead of sparkling. The footprint's longer axis counts, which blurs
# grazing views instead of aliasing them.
#
# Left out: bilinear lookups. Cost: eight texels instead of four, and the pyramid, about two passes
# over the maps.


def filtering_bound(limits: SceneBounds) -> Bound:
    """0 where no pixel covers more than a texel; else the picture's largest radiance."""
    if limits.footprint <= 1.0 + 1e-6:
        return Bound(0.0, "no pixel covers more than a texel")
    seen = "infinitely many" if math.isinf(limits.footprint) else f"{limits.footprint:.3g}"
    return Bound(limits.largest_radiance, f"a pixel covers up to {seen} texels")


# Self-shadowing of the height field.
#
# A ray to the light is compared with the surface where it crosses grid lines through texel centres,
# columns first, then rows. On a grid line the bilinear surface is piecewise linear and the test is
# exact; between lines the surface deviates by up to a quarter of the cell's |h00 + h11 - h01 -
# h10|. A ray ends at the height field's top or at the light. The height field continues beyond the
# border of the surface; distant parts of a curved surface cast no shadows.
#
# Left out: attached shadows only (n.l <= 0). Cost: two texels a grid line, over the length of the
# highest point's shadow.


def shadows_bound(limits: SceneBounds) -> Bound:
    """Radiance of the lights that are lower, somewhere, than the relief's steepest slope.

    A height field with slopes up to s casts no shadow under a light whose elevation has tan >= s.
    """
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


# Visibility of environments over the relief: horizon maps [max1988].
#
# Diffuse irradiance is multiplied by the texel's sky view factor. Each sampled direction of the
# specular lobe is compared with the horizon, interpolated between the two nearest of 16 azimuths
# (matcap.relight.relief).
#
# Left out: every point sees the whole upper hemisphere. Cost: about 500 texels a visible texel,
# once a material; two lookups a sampled direction.


def visibility_bound(limits: SceneBounds) -> Bound:
    """0 on a flat surface; else the largest radiance reflected from the environments."""
    if limits.environment == 0.0:
        return Bound(0.0, "there is no environment light")
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    slope = math.degrees(math.atan(limits.relief_slope))
    return Bound(limits.environment_radiance, f"horizons of up to {slope:.3g} degrees")


# One diffuse bounce between neighbouring parts of the relief, by precomputed transfer [sloan2002].
#
# matcap.relight.relief computes for each texel and colour a vector t: light of irradiance e from
# direction l sends the texel irradiance t . (e l) by way of its neighbours. All lights together are
# one scalar product with the vector irradiance. Approximations: neighbours receive the texel's own
# light, without shadows; neighbours that face away from it count negative instead of 0, and the sum
# is clamped to 0. The texel reflects diffusely.
#
# Left out: no bounce. Cost: about 8000 operations a texel, once; a lookup of nine numbers a pixel.

# Radiance that stands for a tolerance of 0, in a denominator.
_TINY: Any = np.float32(1e-30)


def interreflection_bound(limits: SceneBounds) -> Bound:
    """(albedo / pi)^2 times irradiance times the projected solid angle that neighbours can fill.

    No neighbour is higher than e, the angle of the steepest slope. A normal tilted by t <= e has
    projected solid angle pi cos(t) cos(e)^2 above e, of pi in all: neighbours fill at most
    pi (1 - cos(e)^3).
    """
    light = sum(one.irradiance for one in limits.lights) + math.pi * limits.environment
    if light == 0.0:
        return Bound(0.0, "there is no light")
    if limits.relief == 0.0:
        return Bound(0.0, "the surface is flat")
    steepest = math.atan(limits.relief_slope)
    hidden = math.pi * (1.0 - math.cos(steepest) ** 3)
    reason = f"slopes of up to {math.degrees(steepest):.3g} degrees light each other"
    return Bound(limits.lambert**2 * light * hidden, reason)


def add_interreflection(block: Block) -> None:
    """Add the bounce to a block, in the pixels and with the precision that the budget asks for."""
    horizons, size = block.context.horizons, block.context.relief.texture.size
    assert horizons is not None
    for fine, which in _parts(block):
        if not len(which):
            continue
        transfer = horizons.transfer(block.column, block.row, which, fine=fine)
        loops().matcap_relight_bounce(
            byref(block.as_c), Whole(size[0]), Whole(size[1]), address(transfer),
            c_int64(len(which)), address(which),
        )  # fmt: skip
        block.ran("interreflection", which)


def _parts(block: Block) -> list[tuple[bool, Array]]:
    """Indices of the pixels that need coarse transfer (False) and fine transfer (True)."""
    budget = block.context.budget
    if budget is None:
        return [(True, np.flatnonzero(block.facing).astype(np.int32))]
    assert block.vector_irradiance is not None and block.context.horizons is not None
    allowed = budget.radiance("interreflection", block.total)
    most: Any = np.float32(0.0)
    around = block.context.relief.albedo_around(block.column, block.row) * np.float32(1.0 / math.pi)
    for channel in range(3):
        x, y, z = block.vector_irradiance[3 * channel : 3 * channel + 3]
        change = block.sample.diffuse[channel] * np.sqrt(x * x + y * y + z * z) * around[channel]
        most = np.maximum(most, change * block.open[1] / np.maximum(allowed[channel], _TINY))
    most = most * block.facing
    fine = most * np.float32(COARSENESS) > 1.0
    coarse = (most > 1.0) & ~fine
    block.context.horizons.shared = bool(coarse.mean() > 0.5)
    return [(one, np.flatnonzero(x).astype(np.int32)) for one, x in ((False, coarse), (True, fine))]
