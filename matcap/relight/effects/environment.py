"""Light of the surroundings.

Diffuse: irradiance tabulated over normals, summed over 256 x 128 directions (Ramamoorthi and
Hanrahan 2001 for the idea; a table instead of harmonics, error below 3e-4 of the light). On a
plane only what stands above it shines; on a curved surface the part of a normal's hemisphere
below the surface is taken to be as bright as the rest of it.

Specular: visible normals are sampled at 64 points or more, the same for every pixel, each with the
surroundings averaged over the solid angle it stands for (Krivanek and Colbert 2008). Only what
differs from the mean radiance is sampled; the mean's part is known from the albedo tables. The
error is measured in docs/relighting.md.

Left out: surroundings as bright everywhere as they are on average; exact albedo tables for both
lobes. Cost: 64 lookups and about fifty operations each a pixel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from matcap.relight.effects.bound import DEFAULT_TOLERANCE, Bound
from matcap.relight.environment import Environment
from matcap.relight.facts import Facts
from matcap.relight.sampling import Sample
from matcap.relight.surfaces.hits import Hits, to_frame, to_scene
from matcap.relight.tables import albedo
from matcap.relight.vectors import Array, Vec, add, vec
from matcap.relight.visible_normals import mirrored

SAMPLES = 64  # at the default tolerance
_MOST = 4096
# The specular lobe reflects no more than this share, tables' rounding included.
_WHOLE = 1.01


def samples_for(tolerance: float) -> int:
    """How many directions a tolerance calls for: a tenth of it, ten times as many."""
    wanted = SAMPLES * DEFAULT_TOLERANCE / max(tolerance, 1e-9)
    return round(min(max(wanted, SAMPLES), _MOST))


def brightest(facts: Facts) -> float:
    """Largest radiance that the environments can cause."""
    return facts.sky * (facts.diffuse + _WHOLE)


def mirrored_bound(facts: Facts) -> float:
    """Largest radiance that the environments can cause by the specular lobe."""
    return facts.sky * _WHOLE


def bound(facts: Facts) -> Bound:
    """What differs from the mean, and what a tilted normal sees below the plane."""
    if facts.sky == 0.0:
        return Bound(0.0, "there are no surroundings")
    if facts.sky_varying == 0.0 and facts.slope == 0.0:
        return Bound(0.0, "the surroundings are the same everywhere")
    both = facts.diffuse + _WHOLE
    # The share of a tilted normal's hemisphere that lies below the plane, diffuse and specular.
    tilt = 1.0 if facts.slope > 0.0 else 0.0
    reason = f"radiance differs by up to {facts.sky_varying:.2g} from its mean"
    return Bound(facts.sky_varying * both + tilt * facts.sky * both, reason)


def diffuse_irradiance(sky: Environment, normal: Vec, hits: Hits) -> Array:
    """(3, ...) irradiance of a block's shading normals."""
    if hits.frame is None:
        return sky.irradiance_above(normal)
    share = np.float32(0.5) * (1.0 + normal[2])
    return sky.irradiance(to_scene(normal, hits.frame)) * share


def irradiance_vector(sky: Environment, hits: Hits) -> list[Vec]:
    """For each colour the sum of radiance times direction, in the material's frame."""
    towards, power = sky.directions
    above = towards[:, 2] > 0.0 if hits.frame is None else slice(None)
    total = towards[above].T.astype(np.float64) @ power[above].astype(np.float64)
    vectors = [to_frame(vec(tuple(total[:, channel])), hits.frame) for channel in range(3)]
    # The mean of all above the surface points straight up.
    return [
        add(vector, vec((0.0, 0.0, math.pi * float(sky.mean[channel]))))
        for channel, vector in enumerate(vectors)
    ]


def specular(
    sky: Environment,
    sample: Sample,
    hits: Hits,
    n_dot_v: Array,
    samples: int,
    horizon: Any = None,  # noqa: ANN401
) -> tuple[Array, Array]:
    """(3, ...) mirrored light, split as Schlick has it: times F0, and on its own.

    Args:
        sky: the environment.
        sample: the material.
        hits: the block.
        n_dot_v: cosines of the view.
        samples: how many directions.
        horizon: a function from directions in the frame to whether they are clear of the relief;
            None where nothing stands in the way.
    """
    shape = np.broadcast_shapes(sample.alpha.shape, n_dot_v.shape)
    # What the mean alone would do is known exactly; only what differs from it is sampled.
    mean = sky.mean.astype(np.float32).reshape(3, *[1] * len(shape))
    scale, bias = (
        np.array(np.broadcast_to(part, (3, *shape)))
        for part in uniform_specular(sky, sample, n_dot_v)
    )
    texel = np.float32(sky.texel_angle * samples)
    last = len(sky.levels) - 1
    for one in mirrored(sample, hits.to_view, n_dot_v, samples):
        clear = one.to_light[2] > 0.0
        if horizon is not None:
            clear &= horizon(one.to_light)
        direction = one.to_light if hits.frame is None else to_scene(one.to_light, hits.frame)
        # Half the binary logarithm of how many texels the sample's solid angle covers.
        wide = 0.5 * np.log2(np.maximum(1.0 / (one.density * texel), np.float32(1e-6)))
        level = np.clip(np.rint(wide), 0, last).astype(np.int32)
        light = sky.radiance(direction, level) * clear - mean
        light *= one.weight * np.float32(1.0 / samples)
        mixed = light * one.fresnel
        bias += mixed
        scale += light - mixed
    return scale, bias


def uniform_specular(sky: Environment, sample: Sample, n_dot_v: Array) -> tuple[Array, Array]:
    """As specular(), of surroundings that are everywhere as on average."""
    tables = albedo()
    rows = tables.rows(sample.alpha)
    bias = tables.lookup(tables.fine_bias, n_dot_v, rows)
    scale = tables.lookup(tables.fine_total, n_dot_v, rows) - bias
    mean = sky.mean.astype(np.float32)[:, None, None]
    return mean * scale, mean * bias


def uniform_irradiance(sky: Environment) -> Array:
    """(3, 1, 1) irradiance of surroundings that are everywhere as on average."""
    whole: Array = (math.pi * sky.mean).astype(np.float32)[:, None, None]
    return whole
