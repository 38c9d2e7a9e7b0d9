"""Fields of a surface (albedo, roughness, height) of each kind, and the finish common to all.

A kind draws its parameters from one generator and its realisation from the canvas, and marks its
cavities. The finish darkens and roughens these, adds fine grain and scales the relief to a slope.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from matcap.brdf.maps import MapSet
from matcap_lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    VoronoiCells,
    assemble,
    bumps,
    cells,
    displacement,
    mix,
    noise,
    pick,
    smoothstep,
)
from matcap_lab.simulate.varied import CLAYS, STONES, Draws, Integers

# Ranges of real surfaces: fresh charcoal to snow, polished stone to chalk.
_ALBEDO = (0.01, 0.9)
_ROUGHNESS = (0.08, 0.95)
# Deviation of the blur that rounds edges, plane units: 0.3 mm where 2 units are 25 cm.
_EDGE = 0.0025


@dataclass(frozen=True)
class SurfaceFields:
    """Fields of one realisation; each broadcasts to (H, W), diffuse to (3, H, W)."""

    diffuse: Raster
    """Albedo, linear Rec.709."""
    specular: Raster | float
    """F0; (3, H, W), linear Rec.709, where it has a colour."""
    roughness: Raster | float
    """Perceptual roughness."""
    height: Raster
    """Height in any unit; the finish scales it to a slope."""
    cavity: Raster
    """0 on tops to 1 in grooves."""


# (canvas, parameters) to a realisation.
SurfaceFunction = Callable[[Canvas, Draws], SurfaceFields]


@dataclass(frozen=True)
class Kind:
    """A family of materials."""

    surface: SurfaceFunction
    """Realises one of them."""
    slopes: tuple[float, float]
    """Range of the relief's root mean square slope."""
    grain: tuple[float, float] = (0.004, 0.06)
    """Range of the fine grain's root mean square slope."""
    darkest: float = _ALBEDO[0]
    """Least diffuse albedo."""


def finish(canvas: Canvas, kind: Kind, depth: float, rng: Draws) -> tuple[MapSet, Raster]:
    """Maps of a realisation, and (H, W) its relief, `depth` times the height, without grain.

    Cavities are darker, and rougher, in 3 of 4 materials each, else the opposite; neither in 15 %.
    """
    tied = not rng.chance(0.15)
    coarse = rng.log_uniform(0.01, 0.06)
    # Of log albedo and of roughness, from open surface to cavity.
    darkening = tied * (1.0 if rng.chance(0.75) else -0.4) * rng.log_uniform(0.08, 1.4)
    roughening = tied * (1.0 if rng.chance(0.75) else -0.6) * rng.log_uniform(0.02, 0.35)
    spectrum = Spectrum(coarse, min(rng.log_uniform(0.005, 0.012), 0.7 * coarse), rng.random())
    # Standard deviations of log albedo and of roughness by grain; of log albedo over features.
    by_grain, wear = rng.log_uniform(0.01, 0.16), rng.log_uniform(0.003, 0.05)
    by_drift = rng.log_uniform(0.01, 0.12)
    steepness = rng.log_uniform(*kind.grain)
    surface = kind.surface(canvas, rng)
    grain = noise(canvas, "grain", spectrum)
    drift = noise(canvas, "drift", Spectrum(0.16, 0.05))
    tone = np.exp(by_grain * grain + by_drift * drift - darkening * surface.cavity)
    # Steps are smoothed, as by wear and the lens's blur.
    height = np.ascontiguousarray(np.broadcast_to(surface.height, grain.shape))
    rounded = cv2.GaussianBlur(height, (0, 0), _EDGE / canvas.texel_size)
    relief = depth * np.asarray(rounded, np.float64)
    rough = surface.roughness + roughening * surface.cavity + wear * grain
    maps = assemble(
        canvas,
        np.clip(surface.diffuse * tone, kind.darkest, _ALBEDO[1]),
        surface.specular,
        np.clip(rough, *_ROUGHNESS),
        relief + steepness * bumps(canvas, "grain", spectrum),
        min(kind.darkest, _ALBEDO[0]),
    )
    return maps, relief


# Placement of a material's elements: rotated lattices, borders of cells, overlapping stamps.

# Evaluations of a stamp's profile worked on at a time: small enough to stay in the cache.
_CHUNK = 200_000


def frame(
    canvas: Canvas, label: str, angle: float, bend: float, reach: float
) -> tuple[Raster, Raster]:
    """(H, W) plane coordinates along and across a direction, in plane units, slightly warped.

    Args:
        canvas: rectangle and seed.
        label: random stream of the warp and the origin.
        angle: of the first coordinate, radians anticlockwise from x.
        bend: wavelength of the warp, plane units.
        reach: standard deviation of the warp, plane units.
    """
    cosine, sine = math.cos(angle), math.sin(angle)
    start = canvas.stream(label + " start").uniform(0.0, 10.0, size=2)
    along = canvas.x * cosine - canvas.y * sine + start[0]
    across = canvas.x * sine + canvas.y * cosine + start[1]
    if reach > 0:
        spectrum = Spectrum(coarse=bend, fine=0.5 * bend)
        along = along + reach * noise(canvas, label + " bend along", spectrum)
        across = across + reach * noise(canvas, label + " bend across", spectrum)
    return along, across


def warp(canvas: Canvas, label: str, size: float, reach: float) -> tuple[Raster, Raster]:
    """Two displacement fields of wavelength `size` and deviation `reach`, plane units."""
    spectrum = Spectrum(coarse=1.5 * size, fine=0.4 * size)
    return displacement(canvas, label + " warp", spectrum, reach)


def border_distance(canvas: Canvas, cell: VoronoiCells) -> Raster:
    """(H, W) distance to the border of two cells, in plane units, to first order."""
    border = cell.border
    down, right = np.gradient(border, canvas.texel_size)
    return border / np.maximum(np.hypot(down, right), 0.3 * float(np.hypot(down, right).mean()))


# Offsets from the centre (n, P, P) in plane units, right and down, and which stamps (n, 1, 1):
# heights (n, P, P), -inf outside the stamp.
Profile = Callable[[Raster, Raster, Integers], Raster]


def scatter(canvas: Canvas, label: str, pitch: float) -> tuple[Raster, Raster, np.random.Generator]:
    """One stamp to each square of side `pitch`, plane units, uniformly distributed in it.

    Returns:
        (N,) x and y of the centres in plane units, y downwards, some of them outside the canvas;
        and the generator that drew them, for their sizes: at most 8 pitches.
    """
    margin = 8 if pitch < 0.02 else 4
    columns, rows = (math.ceil(side / pitch) + 2 * margin for side in canvas.extent)
    generator = canvas.stream(label)
    shift, jitter = generator.random(2), generator.random((2, rows, columns))
    x = (np.arange(columns)[None, :] + jitter[0] + shift[0] - margin - 0.5) * pitch
    y = (np.arange(rows)[:, None] + jitter[1] + shift[1] - margin - 0.5) * pitch
    return x.ravel(), y.ravel(), generator


def splat(
    canvas: Canvas, x: Raster, y: Raster, reach: Raster, profile: Profile, floor: float
) -> tuple[Raster, Integers]:
    """Upper envelope of overlapping stamps.

    Args:
        canvas: rectangle.
        x, y: (N,) centres in plane units, y downwards.
        reach: (N,) half the side of each stamp's bounding square, plane units.
        profile: heights of stamps.
        floor: height where there is no stamp.

    Returns:
        (H, W) height, `floor` where there is no stamp, and (H, W) index of the top stamp, else -1.
    """
    texel = canvas.texel_size
    shape = (canvas.height, canvas.width)
    top = np.full(shape[0] * shape[1], -np.inf)
    seen = np.full(top.size, -1, dtype=np.int64)
    left = np.ceil((x - reach) / texel - 0.5).astype(np.int64)
    first = np.ceil((y - reach) / texel - 0.5).astype(np.int64)
    side = np.maximum(1, np.ceil(2.0 * reach / texel).astype(np.int64))
    visible = (
        (left < shape[1]) & (left + side > 0) & (first < shape[0]) & (first + side > 0)
    ).nonzero()[0]
    # Stamps of about the same size share an array.
    visible = visible[np.argsort(side[visible], kind="stable")]
    start = 0
    while start < visible.size:
        widest = int(side[visible[start]] * 1.25) + 1
        stop = start + max(1, _CHUNK // widest**2)
        chosen = visible[start:stop]
        chosen = chosen[side[chosen] <= widest]
        start += chosen.size
        steps = np.arange(int(side[chosen].max()))
        column = left[chosen, None, None] + steps[None, None, :]
        row = first[chosen, None, None] + steps[None, :, None]
        dx = (column + 0.5) * texel - x[chosen, None, None]
        dy = (row + 0.5) * texel - y[chosen, None, None]
        height = profile(dx, dy, chosen[:, None, None])
        inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
        kept = (inside & (height > -np.inf)).nonzero()
        place = (row * shape[1] + column)[kept]
        high = height[kept]
        np.maximum.at(top, place, high)
        winner = high >= top[place]
        seen[place[winner]] = chosen[kept[0][winner]]
    return np.where(seen >= 0, top, floor).reshape(shape), seen.reshape(shape)


def rotated(dx: Raster, dy: Raster, turn: Raster) -> tuple[Raster, Raster]:
    """Offsets along and across a direction `turn`, radians."""
    cosine, sine = np.cos(turn), np.sin(turn)
    return dx * cosine - dy * sine, dx * sine + dy * cosine


def polygons(
    generator: np.random.Generator, count: int, corners: int = 6, ragged: float = 0.5
) -> Callable[[Raster, Raster, Integers], Raster]:
    """Convex polygons of radius about 1: (u, v, index) to 1 in the middle, 0 on the border.

    Each has `corners` sides and is irregular by `ragged`, 0 to 1.
    """
    step = 2.0 * math.pi / corners
    turn = generator.uniform(0.0, 2.0 * math.pi, (count, 1)) + step * np.arange(corners)
    turn = turn + 0.45 * ragged * step * generator.uniform(-1.0, 1.0, turn.shape)
    radius = 1.0 - 0.5 * ragged * generator.random(turn.shape)
    cosine, sine = np.cos(turn), np.sin(turn)

    def inside(u: Raster, v: Raster, which: Integers) -> Raster:
        least = np.full(np.broadcast_shapes(u.shape, v.shape), np.inf)
        for side in range(corners):
            far = u * cosine[which, side] + v * sine[which, side]
            np.minimum(least, 1.0 - far / radius[which, side], out=least)
        return least

    return inside


def paths(
    canvas: Canvas,
    label: str,
    pitch: float,
    pieces: int,
    step: float,
    curl: float,
    direction: tuple[float, float],
) -> tuple[Raster, Raster, Raster, Integers]:
    """Chains of short straight pieces: fibres, scratches.

    Args:
        canvas: rectangle and seed.
        label: random stream.
        pitch: one chain to a square of this side, plane units.
        pieces: number of pieces to a chain.
        step: length of a cell_noise, plane units.
        curl: standard deviation of the angle between successive pieces, radians.
        direction: mean and standard deviation of the chains' directions, radians.

    Returns:
        (N,) x and y of the pieces' centres, their directions, radians, and their chain's index.
    """
    span = 0.5 * pieces * step
    width, height = canvas.extent
    columns, rows = (math.ceil((side + 2.0 * span) / pitch) for side in (width, height))
    generator = canvas.stream(label)
    count = columns * rows
    start_x = (np.arange(columns)[None, :] + generator.random((rows, columns))) * pitch - span
    start_y = (np.arange(rows)[:, None] + generator.random((rows, columns))) * pitch - span
    # Constant curvature makes arcs, random curvature wriggles.
    steady = generator.standard_normal((count, 1)) * np.arange(pieces)
    unsteady = np.cumsum(generator.standard_normal((count, pieces)), axis=1)
    turn = direction[0] + direction[1] * generator.standard_normal(count)[:, None]
    turn = turn + curl * (0.5 * steady + unsteady)
    right, down = step * np.cos(turn), -step * np.sin(turn)
    x = start_x.reshape(-1, 1) + np.cumsum(right, axis=1)
    y = start_y.reshape(-1, 1) + np.cumsum(down, axis=1)
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    x, y = x + start_x.reshape(-1, 1), y + start_y.reshape(-1, 1)
    whose = np.repeat(np.arange(count), pieces)
    return x.ravel(), y.ravel(), turn.ravel(), whose


# Closed cells parted by grooves, and glaze parted by thin cracks.


def plates(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Domed or flat plates between grooves: scales, dried mud, pebbled plastic."""
    size = rng.log_uniform(0.025, 0.15)
    base = rng.natural(CLAYS) if rng.chance(0.5) else rng.dye()
    jitter, stretch, turn = rng.uniform(0.4, 1.0), rng.log_uniform(1.0, 1.8), rng.angle()
    bend = warp(canvas, "plates", size, size * rng.uniform(0.0, 0.1))
    plate = cells(canvas, "plates", size, jitter=jitter, stretch=stretch, angle=turn, warp=bend)
    edge = border_distance(canvas, plate) / size
    width = rng.log_uniform(0.05, 0.18)
    groove = np.exp(-((edge / width) ** 2))
    roundness = rng.uniform(0.1, 1.2) * (1.0 if rng.chance(0.8) else -0.5)
    tilt = 0.25 * rng.random() * (plate.offset[0] * (2 * plate.draw(canvas.stream("tilt")) - 1))
    level = rng.uniform(0.0, 0.3) * plate.draw(canvas.stream("level"))
    dome = 1.0 - np.exp(-np.maximum(edge - 0.5 * width, 0.0) / 0.25)
    height = (roundness * dome + level + tilt) * (1.0 - groove) - rng.uniform(0.2, 0.8) * groove
    wrinkle = noise(canvas, "wrinkle", Spectrum(0.4 * size, min(0.008, 0.2 * size)))
    height = height + 0.03 * rng.random() * wrinkle
    tones = rng.shades(base, 7, rng.choice([0.0, 0.1, 0.35]))
    diffuse = pick(tones, plate.draw(canvas.stream("tone")))
    diffuse = diffuse * np.exp(rng.uniform(0.0, 0.12) * wrinkle)
    worn = rng.uniform(-0.1, 0.1)
    gloss = rng.uniform(0.0, 0.12) * (plate.draw(canvas.stream("gloss")) - 0.5)
    rough = rng.uniform(0.18, 0.85) + worn * dome + gloss
    return SurfaceFields(diffuse, rng.dielectric(), rough, size * height, groove)


def crackle(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """A flat, glossy glaze with thin cracks, older ones wider and dirtier."""
    size = rng.log_uniform(0.05, 0.16)
    glaze = rng.dye()
    bend = warp(canvas, "old", size, 0.08 * size)
    old = border_distance(canvas, cells(canvas, "old", size, warp=bend))
    young = border_distance(
        canvas, cells(canvas, "young", size * rng.uniform(0.3, 0.55), warp=bend)
    )
    width = rng.log_uniform(0.003, 0.007)
    spread = noise(canvas, "width", Spectrum(0.12, 0.04))
    crack = np.exp(-((old / (width * np.exp(0.3 * spread))) ** 2))
    some = smoothstep(0.3, -0.3, noise(canvas, "some", Spectrum(2 * size, size)))
    hair = rng.uniform(0.0, 0.8) * some * np.exp(-((young / (0.6 * width)) ** 2))
    crack = np.maximum(crack, hair)
    dirt = rng.shade(glaze, 0.5) if rng.chance(0.3) else rng.natural(STONES) * 0.3
    halo = 0.35 * rng.random() * np.exp(-old / (5.0 * width))
    cloud = noise(canvas, "cloud", Spectrum(0.15, 0.02, slope=1.3))
    body = glaze[:, None, None] * np.exp(rng.uniform(0.02, 0.25) * cloud)
    diffuse = mix(body, dirt[:, None, None], np.maximum(crack, halo))
    specular = mix(np.array(rng.uniform(0.04, 0.065)), np.array(0.03), crack)
    rough = rng.uniform(0.08, 0.28) + rng.uniform(0.2, 0.5) * crack + 0.01 * cloud
    ripple = noise(canvas, "ripple", Spectrum(0.16, 0.05, slope=1.5))
    height = -width * crack + rng.uniform(0.0, 0.35) * width * ripple
    return SurfaceFields(diffuse, specular, rough, height, crack)
