"""Environment maps: diffuse irradiance and the specular lobe.

Diffuse: irradiance by normal [ramamoorthi2001], in a table (not harmonics), summed over 256 x 128
directions; error below 1e-3 of the light. On a plane, directions below it count nothing. On a
curved surface, the part of a normal's hemisphere below the surface is taken to be as bright as the
rest of it.

Specular: a lattice of 144 visible normals or more, the same for every pixel; each looks up the map
averaged over its solid angle [krivanek2008]. Only the difference from the mean radiance is sampled;
the mean times the lobe's albedo is tabulated. Errors are measured in docs/notes/relighting.md.

Small bright spots (suns), which few samples would meet, are removed from the map and shaded as
directional lights.

Left out: an environment of its mean radiance everywhere, by albedo tables. Cost: 144 lookups of
about fifty operations a pixel; a third of that under a constant environment.
"""

from __future__ import annotations

import math
from ctypes import byref, c_int64
from typing import Any

import numpy as np

from matcap.relight.block import Block, Hits, to_frame, to_scene
from matcap.relight.camera import Array, Vec, dot, vec
from matcap.relight.effects import DEFAULT_TOLERANCE, Bound, direct
from matcap.relight.effects.multiscatter import albedo
from matcap.relight.environment_map import Environment
from matcap.relight.loops.library import CHorizon, address, directions, loops
from matcap.relight.plan import LARGEST_ALBEDO, SceneBounds

SAMPLES = 144  # at the default tolerance
_MOST = 4181
# Side of the averaged solid angle over that of a sample's own: 1 blunts smooth maps, 0 misses
# small bright spots.
_BLUR = 0.5


def samples_for(tolerance: float) -> int:
    """Number of samples: 144 at the default tolerance, inversely proportional below it."""
    wanted = SAMPLES * DEFAULT_TOLERANCE / max(tolerance, 1e-9)
    return round(min(max(wanted, SAMPLES), _MOST))


def bound(limits: SceneBounds) -> Bound:
    """Albedo times largest difference from the mean, plus what tilted normals see below z = 0."""
    if limits.environment == 0.0:
        return Bound(0.0, "there is no environment light")
    if limits.environment_variation == 0.0 and limits.slope == 0.0:
        return Bound(0.0, "the environment is the same everywhere")
    both = limits.diffuse + LARGEST_ALBEDO
    # Share of a tilted normal's hemisphere below the plane, bounded by all of it.
    tilt = 1.0 if limits.slope > 0.0 else 0.0
    reason = f"radiance differs by up to {limits.environment_variation:.2g} from its mean"
    if limits.environment_variation == 0.0:
        reason = "tilted normals face below the horizon"
    return Bound(limits.environment_variation * both + tilt * limits.environment * both, reason)


def add(block: Block, environment: Environment) -> None:
    """Add the light of an environment to a block."""
    plan, tally, sample = block.plan, block.context.tally, block.sample
    varied, seen = plan.on("environment"), np.ones(1, dtype=np.float32)
    if plan.on("visibility"):
        with tally.timed("visibility"):
            seen = block.open[0]
            block.ran("visibility")
    mean = environment.mean.astype(np.float32)
    with tally.timed("environment"):
        if varied:
            irradiance = diffuse_irradiance(environment, sample.normal, block.hits) * seen
        else:
            irradiance = np.float32(math.pi) * mean[:, None] * seen
        if plan.on("diffuse"):
            for channel in range(3):
                lambert = sample.diffuse[channel] * np.float32(1.0 / math.pi)
                block.total[channel] += lambert * irradiance[channel]
        if plan.on("specular") and varied:
            _add_specular(block, environment)
        elif plan.on("specular"):
            _add_reflection(block, *(mean[:, None] * (one * seen) for one in _lobe_albedo(block)))
    if block.share:
        with tally.timed("multiscatter"):
            for channel in range(3):
                share = block.share[channel % len(block.share)]
                block.total[channel] += share * irradiance[channel] * np.float32(1.0 / math.pi)
    if block.vector_irradiance is not None:
        for channel, vector_irradiance in enumerate(_vector_irradiance(environment, block.hits)):
            for axis in range(3):
                block.vector_irradiance[3 * channel + axis] += vector_irradiance[axis]


def _add_reflection(block: Block, scale: Array, bias: Array) -> None:
    """Add F0 scale + bias, both (3, N) radiance."""
    for channel in range(3):
        f0 = block.sample.specular[channel % len(block.sample.specular)]
        mirror = f0 * scale[channel] + bias[channel]
        # Mean plus sampled difference may come out below 0.
        block.total[channel] += np.maximum(mirror, np.float32(0.0))


def _lobe_albedo(block: Block) -> tuple[Array, Array]:
    """(N,) scale and bias of the lobe's albedo, F0 scale + bias: reflection of radiance 1."""
    tables = albedo()
    rows = tables.rows(block.sample.alpha)
    bias = tables.lookup(tables.fine_bias, block.n_dot_v, rows)
    return tables.lookup(tables.fine_total, block.n_dot_v, rows) - bias, bias


def _add_specular(block: Block, environment: Environment) -> None:
    """Add the specular reflection: the mean's by tables, the rest sampled, suns as lights.

    Under a constant environment only occlusion is sampled, and with a budget only in pixels where
    all of the reflection is above it.
    """
    context, rest, needed = block.context, environment.without_suns, block.facing
    mean = rest.mean.astype(np.float32)
    scale, bias = (mean[:, None] * one for one in _lobe_albedo(block))
    if context.budget is not None and rest.varying == 0.0:
        # Occlusion removes no more than the whole reflection.
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
        plain, mixed = _sampled(block, rest, horizon, which)
        scale[:, which] += plain
        bias[:, which] += mixed
        block.ran("environment", which)
    _add_reflection(block, scale, bias)
    for sun in environment.suns:
        lamp = direct.sun(sun.direction, sun.irradiance)
        hides = bool(horizon.tangents)
        direct.add_lamp(block, lamp, direct.above_horizon(block, lamp, horizon) if hides else None)


def _sampled(block: Block, rest: Environment, horizon: CHorizon, which: Array) -> Array:
    """(2, 3, n) correction of scale and bias, in F0 scale + bias, by sampling the lobe.

    It is the reflection of the environment with occlusion, less that of its mean without, at pixels
    `which`.
    """
    c_directions = directions(block.context.samples)
    if rest.varying == 0.0:
        hidden = np.empty((2, len(which)), dtype=np.float32)
        loops().matcap_relight_hidden(
            byref(block.as_c), byref(c_directions), byref(horizon), c_int64(len(which)),
            address(which), address(hidden),
        )  # fmt: skip
        return -rest.mean.astype(np.float32)[None, :, None] * hidden[:, None]
    correction, maps = np.empty((2, 3, len(which)), dtype=np.float32), rest.octahedra.as_c()
    maps.blur, maps.mean = _BLUR, tuple(float(one) for one in rest.mean)
    loops().matcap_relight_sky(
        byref(block.as_c), byref(c_directions), byref(maps), byref(horizon), c_int64(len(which)),
        address(which), address(correction),
    )  # fmt: skip
    return correction


def diffuse_irradiance(environment: Environment, normal: Vec, hits: Hits) -> Array:
    """(3, ...) irradiance on shading normals: from tables, and each sun's in closed form.

    A table would blur the terminator of a sun.
    """
    rest, share = environment.without_suns, np.float32(0.5) * (1.0 + normal[2])
    if rest.varying == 0.0:
        irradiance: Any = (math.pi * rest.mean).astype(np.float32)[:, None] * share
    elif hits.frame is None:
        irradiance = rest.irradiance_above(normal)
    else:
        irradiance = rest.irradiance(to_scene(normal, hits.frame)) * share
    for sun in environment.suns:
        to_light = to_frame(vec(sun.direction), hits.frame)
        facing = np.maximum(dot(normal, to_light), np.float32(0.0))
        facing = facing * ((to_light[2] > 0.0) if hits.frame is None else share)
        irradiance = irradiance + facing * np.array(sun.irradiance, dtype=np.float32)[:, None]
    return irradiance


def _vector_irradiance(environment: Environment, hits: Hits) -> list[Vec]:
    """For each colour the integral of radiance times direction, in the material's frame."""
    total, vectors = environment.vector(above=hits.frame is None), []
    for channel in range(3):
        x, y, z = to_frame(vec(tuple(total[:, channel])), hits.frame)
        # Uniform radiance over the upper hemisphere integrates to pi along z.
        vectors.append((x, y, z + np.float32(math.pi * float(environment.mean[channel]))))
    return vectors
