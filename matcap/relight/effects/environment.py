"""Light of the surroundings.

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

import numpy as np

from matcap.relight import compiled
from matcap.relight.effects.bound import DEFAULT_TOLERANCE, Bound
from matcap.relight.effects.visibility import HorizonTest
from matcap.relight.environment_map import Environment, Sun
from matcap.relight.facts import WHOLE, Facts
from matcap.relight.lobes import ggx_smith, schlick_weight
from matcap.relight.sampling import SurfaceSample
from matcap.relight.surfaces.hits import Hits, to_frame, to_scene
from matcap.relight.tables import albedo
from matcap.relight.vectors import Array, Vec, add, dot, vec
from matcap.relight.visible_normals import Lobe, lattice, lobe_of

SAMPLES = 144  # at the default tolerance
_MOST = 4181
# How much of a direction's solid angle its lookup averages over, a side: all of it blunts smooth
# lights, none of it misses small ones.
_BLUR = np.float32(0.5)


def samples_for(tolerance: float) -> int:
    """How many directions a tolerance calls for: a tenth of it, ten times as many."""
    wanted = SAMPLES * DEFAULT_TOLERANCE / max(tolerance, 1e-9)
    return round(min(max(wanted, SAMPLES), _MOST))


def mirrored_bound(facts: Facts) -> float:
    """Largest radiance that the environments can cause by the specular lobe."""
    return facts.sky * WHOLE


def bound(facts: Facts) -> Bound:
    """What differs from the mean, and what a tilted normal sees below the plane."""
    if facts.sky == 0.0:
        return Bound(0.0, "there are no surroundings")
    if facts.sky_varying == 0.0 and facts.slope == 0.0:
        return Bound(0.0, "the surroundings are the same everywhere")
    both = facts.diffuse + WHOLE
    # The share of a tilted normal's hemisphere that lies below the plane, diffuse and specular.
    tilt = 1.0 if facts.slope > 0.0 else 0.0
    reason = f"radiance differs by up to {facts.sky_varying:.2g} from its mean"
    return Bound(facts.sky_varying * both + tilt * facts.sky * both, reason)


def diffuse_irradiance(sky: Environment, normal: Vec, hits: Hits) -> Array:
    """(3, ...) irradiance of a block's shading normals; tables would blunt suns' terminators."""
    calm = sky.calm
    share: Array = np.ones(1, np.float32)
    if hits.frame is None:
        found = calm.irradiance_above(normal)
    else:
        share = np.float32(0.5) * (1.0 + normal[2])
        found = calm.irradiance(to_scene(normal, hits.frame)) * share
    for sun in sky.suns:
        to_light = to_frame(vec(sun.direction), hits.frame)
        facing = np.maximum(dot(normal, to_light), np.float32(0.0)) * share
        if hits.frame is None:
            facing = facing * (to_light[2] > 0.0)
        power = np.array(sun.irradiance, dtype=np.float32).reshape(3, *[1] * facing.ndim)
        found = found + facing * power
    return found


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
    sample: SurfaceSample,
    hits: Hits,
    n_dot_v: Array,
    samples: int,
    horizon: HorizonTest | None = None,
    highest: Array | None = None,
) -> tuple[Array, Array]:
    """(3, ...) mirrored light, split as Schlick has it: times F0, and on its own.

    Args:
        sky: the environment.
        sample: the material.
        hits: the block.
        n_dot_v: cosines of the view.
        samples: how many directions.
        horizon: of the relief; None where nothing stands in the way.
        highest: see hidden().
    """
    lobe = lobe_of(sample, hits.to_view, n_dot_v)
    calm = sky.calm
    # What the mean alone would do is known exactly; only what differs from it is sampled.
    mean = calm.mean.astype(np.float32)[:, None, None]
    tables = uniform_specular(calm, sample, n_dot_v)
    if calm.varying == 0.0:
        scale, bias = hidden(lobe, samples, horizon, highest)
        return tables[0] - mean * scale, tables[1] - mean * bias
    shape = (3, *lobe.middle[2].shape)
    scale, bias = (np.array(np.broadcast_to(part, shape)) for part in tables)
    for point in lattice(samples):
        one = lobe.mirrored(point)
        clear = one.above
        if horizon is not None:
            clear = clear & horizon(one.to_light, None)
        direction = to_scene(one.to_light, hits.frame)
        light = calm.octahedra.radiance(direction, one.wide * _BLUR) * clear - mean
        light *= one.weight
        mixed = light * one.fresnel
        bias += mixed
        scale += light - mixed
    for sun in sky.suns:
        plain, fresnel = _sunlight(sun, sample, hits, n_dot_v, horizon)
        for channel, power in enumerate(sun.irradiance):
            mixed = plain * (fresnel * np.float32(power))
            bias[channel] += mixed
            scale[channel] += plain * np.float32(power) - mixed
    return scale, bias


def _sunlight(
    sun: Sun, sample: SurfaceSample, hits: Hits, n_dot_v: Array, horizon: HorizonTest | None
) -> tuple[Array, Array]:
    """The lobe times n.l towards a sun, and Schlick's weight."""
    to_light = to_frame(vec(sun.direction), hits.frame)
    n_dot_l = np.maximum(dot(sample.normal, to_light), np.float32(0.0))
    lobe, l_dot_h = ggx_smith(sample.normal, hits.to_view, to_light, n_dot_v, n_dot_l, sample.alpha)
    clear = to_light[2] > 0.0
    if horizon is not None:
        x, y, z = (np.broadcast_to(c, lobe.shape) for c in to_light)
        clear = clear & horizon((x, y, z), None)
    return lobe * (n_dot_l * clear), schlick_weight(l_dot_h)


def hidden(
    lobe: Lobe, samples: int, horizon: HorizonTest | None, highest: Array | None = None
) -> tuple[Array, Array]:
    """Share of even surroundings that surface and relief hide: times F0, and on its own.

    Most directions of most pixels are clear, and cost no more than finding that out.

    Args:
        lobe: the block's.
        samples: how many directions.
        horizon: see specular().
        highest: sines of the highest elevations that horizons reach; directions above are clear.
    """
    if highest is not None and compiled.kernel() is not None:
        tangents, texel = (None, None) if horizon is None else (horizon.tangents, horizon.texel)
        return compiled.hidden(lobe, samples, tangents, texel, highest)
    scale, bias = (np.zeros(lobe.middle[2].shape, dtype=np.float32) for _ in range(2))
    for point in lattice(samples):
        if highest is not None:
            index = lobe.low(point, highest)
            if len(index):
                some = lobe.take(index).mirrored(point)
                lost = ~some.above
                if horizon is not None:
                    lost |= ~horizon(some.to_light, index)
                weight = some.weight * lost
                mixed = weight * some.fresnel
                bias.ravel()[index] += mixed
                scale.ravel()[index] += weight - mixed
            continue
        one = lobe.mirrored(point)
        lost = ~one.above
        if horizon is not None:
            lost |= ~horizon(one.to_light, None)
        # Many of these are below the shading normal's horizon too, and count nothing.
        index = np.flatnonzero(lost & (one.n_dot_l > 0.0))
        if len(index):
            some = lobe.take(index).mirrored(point)
            mixed = some.weight * some.fresnel
            bias.ravel()[index] += mixed
            scale.ravel()[index] += some.weight - mixed
    return scale, bias


def uniform_specular(
    sky: Environment, sample: SurfaceSample, n_dot_v: Array
) -> tuple[Array, Array]:
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
