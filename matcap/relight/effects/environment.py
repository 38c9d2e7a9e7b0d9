"""Light of the environment map: diffuse irradiance and the mirrored lobe.

Diffuse: irradiance tabulated over normals, summed over 256 x 128 directions (Ramamoorthi and
Hanrahan 2001 for the idea; a table instead of harmonics, error below 1e-3 of the light), and each
sun's (see below) on its own. On a plane only what stands above it shines; on a curved surface the
part of a normal's hemisphere below the surface is taken to be as bright as the rest of it.

Specular: visible normals are sampled at a lattice of 144 points or more, the same for every pixel,
each with the surroundings averaged over the solid angle it stands for (Krivanek and Colbert 2008).
Only what differs from the mean radiance is sampled; the mean's part is known from the albedo
tables. Suns, which few points would meet, are taken out of the picture and shine on their own. The
error is measured in docs/notes/relighting.md.

Left out: surroundings as bright everywhere as they are on average; exact albedo tables for both
lobes. Cost: 144 lookups and about fifty operations each a pixel, a third of it where the
surroundings are the same everywhere.
"""

from __future__ import annotations

import math
from ctypes import byref, c_int64
from typing import TYPE_CHECKING, Any

import numpy as np

from matcap.relight.effects import direct
from matcap.relight.effects.bound import DEFAULT_TOLERANCE, Bound
from matcap.relight.environment_map import Environment
from matcap.relight.loops.library import KeptArrays, address, loops
from matcap.relight.loops.structures import CHorizon, directions
from matcap.relight.scene_bounds import WHOLE, SceneBounds
from matcap.relight.surfaces.hits import Hits, to_frame, to_scene
from matcap.relight.tables import albedo
from matcap.relight.vectors import Array, Vec, dot, vec

if TYPE_CHECKING:
    from matcap.relight.block import Block

SAMPLES = 144  # at the default tolerance
_MOST = 4181
# How much of a direction's solid angle its lookup averages over, a side: all of it blunts smooth
# lights, none of it misses small ones.
_BLUR = 0.5


def samples_for(tolerance: float) -> int:
    """How many directions a tolerance calls for: a tenth of it, ten times as many."""
    wanted = SAMPLES * DEFAULT_TOLERANCE / max(tolerance, 1e-9)
    return round(min(max(wanted, SAMPLES), _MOST))


def bound(limits: SceneBounds) -> Bound:
    """What differs from the mean, and what a tilted normal sees below the plane."""
    if limits.sky == 0.0:
        return Bound(0.0, "there are no surroundings")
    if limits.sky_varying == 0.0 and limits.slope == 0.0:
        return Bound(0.0, "the surroundings are the same everywhere")
    both = limits.diffuse + WHOLE
    # The share of a tilted normal's hemisphere that lies below the plane, diffuse and specular.
    tilt = 1.0 if limits.slope > 0.0 else 0.0
    reason = f"radiance differs by up to {limits.sky_varying:.2g} from its mean"
    if limits.sky_varying == 0.0:
        reason = "tilted normals face what lies below the surface"
    return Bound(limits.sky_varying * both + tilt * limits.sky * both, reason)


def add(block: Block, sky: Environment) -> None:
    """Add the light of surroundings."""
    plan, clock, sample = block.plan, block.context.clock, block.sample
    varied, seen = plan.on("environment"), np.ones(1, dtype=np.float32)
    if plan.on("visibility"):
        with clock.on("visibility"):
            seen = block.open[0]
            block.ran("visibility")
    mean = sky.mean.astype(np.float32)
    with clock.on("environment"):
        if varied:
            irradiance = diffuse_irradiance(sky, sample.normal, block.hits) * seen
        else:
            irradiance = np.float32(math.pi) * mean[:, None] * seen
        if plan.on("diffuse"):
            for channel in range(3):
                lambert = sample.diffuse[channel] * np.float32(1.0 / math.pi)
                block.total[channel] += lambert * irradiance[channel]
        if plan.on("specular") and varied:
            _mirror(block, sky)
        elif plan.on("specular"):
            _reflect(block, *(mean[:, None] * (one * seen) for one in _even(block)))
    if block.share:
        with clock.on("multiscatter"):
            for channel in range(3):
                share = block.share[channel % len(block.share)]
                block.total[channel] += share * irradiance[channel] * np.float32(1.0 / math.pi)
    if block.flow is not None:
        for channel, flow in enumerate(_flow(sky, block.hits)):
            for axis in range(3):
                block.flow[3 * channel + axis] += flow[axis]


def _reflect(block: Block, scale: Array, bias: Array) -> None:
    """Add mirrored light, as Schlick has it: times F0, and on its own."""
    for channel in range(3):
        f0 = block.sample.specular[channel % len(block.sample.specular)]
        mirror = f0 * scale[channel] + bias[channel]
        # The mean is taken away from what is sampled, and may leave less than nothing.
        block.total[channel] += np.maximum(mirror, np.float32(0.0))


def _even(block: Block) -> tuple[Array, Array]:
    """(N,) albedo of the lobe, times F0 and on its own: what surroundings of 1 would do."""
    tables = albedo()
    rows = tables.rows(block.sample.alpha)
    bias = tables.lookup(tables.fine_bias, block.n_dot_v, rows)
    return tables.lookup(tables.fine_total, block.n_dot_v, rows) - bias, bias


def _mirror(block: Block, sky: Environment) -> None:
    """Add what is mirrored, in no more pixels than the budget asks for.

    What the mean alone would do is known exactly; only what differs from it is sampled.
    """
    context, calm, needed = block.context, sky.calm, block.facing
    mean = calm.mean.astype(np.float32)
    scale, bias = (mean[:, None] * one for one in _even(block))
    if context.budget is not None and calm.varying == 0.0:
        # At most all of it is hidden.
        allowed = context.budget.radiance("environment", block.total)
        needed = np.zeros(block.tiles.size, dtype=bool)
        for channel in range(3):
            f0 = block.sample.specular[channel % len(block.sample.specular)]
            needed |= f0 * scale[channel] + bias[channel] > allowed[channel]
        needed &= block.facing
    which = np.flatnonzero(needed).astype(np.int32)
    horizon = CHorizon(adaptive=int(block.adaptive))
    if block.plan.on("visibility") and context.horizons is not None:
        horizon = context.horizons.as_c(adaptive=block.adaptive)
    if len(which):
        plain, mixed = _sampled(block, calm, horizon, which)
        scale[:, which] += plain
        bias[:, which] += mixed
        block.ran("environment", which)
    _reflect(block, scale, bias)
    for sun in sky.suns:
        lamp = direct.sun(sun.direction, sun.irradiance)
        hides = bool(horizon.tangents)
        direct.shine(block, lamp, direct.above(block, lamp, horizon) if hides else None)


def _sampled(block: Block, calm: Environment, horizon: CHorizon, which: Array) -> Array:
    """(2, 3, n) what differs from the mean, times F0 and on its own, of some pixels."""
    c_directions, _ = directions(block.context.samples)
    if calm.varying == 0.0:
        hidden = np.empty((2, len(which)), dtype=np.float32)
        loops().matcap_relight_hidden(
            byref(block.as_c), byref(c_directions), byref(horizon), c_int64(len(which)),
            address(which), address(hidden),
        )  # fmt: skip
        return -calm.mean.astype(np.float32)[None, :, None] * hidden[:, None]
    correction, kept = np.empty((2, 3, len(which)), dtype=np.float32), KeptArrays()
    sky = calm.octahedra.as_c(kept)
    sky.blur, sky.mean = _BLUR, tuple(float(one) for one in calm.mean)
    loops().matcap_relight_sky(
        byref(block.as_c), byref(c_directions), byref(sky), byref(horizon), c_int64(len(which)),
        address(which), address(correction),
    )  # fmt: skip
    return correction


def diffuse_irradiance(sky: Environment, normal: Vec, hits: Hits) -> Array:
    """(3, ...) irradiance of a block's shading normals; tables would blunt suns' terminators."""
    calm, share = sky.calm, np.float32(0.5) * (1.0 + normal[2])
    if calm.varying == 0.0:
        irradiance: Any = (math.pi * calm.mean).astype(np.float32)[:, None] * share
    elif hits.frame is None:
        irradiance = calm.irradiance_above(normal)
    else:
        irradiance = calm.irradiance(to_scene(normal, hits.frame)) * share
    for sun in sky.suns:
        to_light = to_frame(vec(sun.direction), hits.frame)
        facing = np.maximum(dot(normal, to_light), np.float32(0.0))
        facing = facing * ((to_light[2] > 0.0) if hits.frame is None else share)
        irradiance = irradiance + facing * np.array(sun.irradiance, dtype=np.float32)[:, None]
    return irradiance


def _flow(sky: Environment, hits: Hits) -> list[Vec]:
    """For each colour the sum of radiance times direction, in the material's frame."""
    total, vectors = sky.vector(above=hits.frame is None), []
    for channel in range(3):
        x, y, z = to_frame(vec(tuple(total[:, channel])), hits.frame)
        # The mean of all above the surface points straight up.
        vectors.append((x, y, z + np.float32(math.pi * float(sky.mean[channel]))))
    return vectors
