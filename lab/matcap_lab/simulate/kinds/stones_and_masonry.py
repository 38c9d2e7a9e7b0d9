"""Stones, and bricks and setts laid in bonds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from matcap_lab.simulate.kinds.surface import (
    SurfaceFields,
    frame,
    polygons,
    rotated,
    scatter,
    splat,
)
from matcap_lab.simulate.procedural import Canvas, Raster, Spectrum, mix, noise, pick, smoothstep
from matcap_lab.simulate.varied import (
    CLAYS,
    STONES,
    WOODS,
    Draws,
    Integers,
    cell_noise,
    value_noise,
)


def _mixed(rng: Draws, mood: float) -> Raster:
    """(24, 3) linear colours of stones, similar or mixed."""
    quarries = [rng.natural(STONES) for _ in range(int(rng.integers(1, 5)))]
    return np.concatenate([rng.shades(quarry, 6, mood) for quarry in quarries])


def gravel(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Stones of several sizes on one another, rounded by water or broken."""
    size = rng.log_uniform(0.03, 0.13)
    spread, ragged = rng.uniform(0.2, 0.9), rng.uniform(0.2, 1.0)
    rounded, flat = rng.uniform(0.3, 1.0), rng.uniform(0.35, 0.9)
    stretch = rng.uniform(0.0, 0.5)
    tones = _mixed(rng, rng.uniform(0.1, 0.4))

    x, y, sizes = scatter(canvas, "stones", 0.42 * size)
    count = x.size
    reach = 0.65 * size * np.exp(-spread * np.abs(sizes.standard_normal(count)))
    own = canvas.stream("own")
    inside = polygons(own, count, 7, ragged)
    turn = own.uniform(0.0, np.pi, count)
    long = np.exp(stretch * own.standard_normal(count) ** 2 * 0.3)
    level = own.random(count)
    lean = 0.35 * own.standard_normal((2, count))

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = rotated(dx, dy, turn[which])
        radius = reach[which]
        u, v = u / radius, v * long[which] / radius
        corner = inside(u, v, which)
        ball = 1.0 - u * u - v * v
        body = mix(corner, ball, np.array(rounded))
        high = radius * flat * np.sqrt(np.maximum(body, 0.0)) + 0.4 * size * level[which]
        high = high + radius * 0.3 * (u * lean[0][which] + v * lean[1][which])
        return np.where(body > 0.0, high, -np.inf)

    height, index = splat(canvas, x, y, reach, profile, -0.15 * size)
    bare = index < 0
    vein = noise(canvas, "vein", Spectrum(0.5 * size, 0.008, slope=0.8))
    each = np.where(bare, 0.0, own.random(count)[index])
    diffuse = pick(tones, each) * np.exp(rng.uniform(0.02, 0.25) * vein)
    diffuse = np.where(bare, 0.5 * diffuse, diffuse)
    gloss = own.standard_normal(count)[index]
    wet = rng.uniform(0.25, 0.85)
    rough = wet + rng.uniform(0.0, 0.12) * gloss + 0.02 * vein
    specular = rng.dielectric() + 0.004 * own.standard_normal(count)[index]
    cavity = smoothstep(0.55 * size, -0.1 * size, height)
    return SurfaceFields(diffuse, specular.clip(0.025, 0.07), rough, height, cavity)


def asphalt(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Broken stones of all sizes in a dark or pale binder that covers some of them."""
    size = rng.log_uniform(0.02, 0.07)
    ragged = rng.uniform(0.4, 1.0)
    tones = _mixed(rng, 0.3)
    binder = rng.natural(STONES[[2, 3]] if rng.chance(0.7) else STONES) * 0.8

    x, y, sizes = scatter(canvas, "stones", 0.55 * size)
    count = x.size
    reach = 0.6 * size * sizes.random(count) ** 1.2 + 0.1 * size
    own = canvas.stream("own")
    inside = polygons(own, count, 5, ragged)
    level = own.normal(0.0, 1.0, count)
    lean = rng.uniform(0.1, 0.5) * own.standard_normal((2, count))
    plateau = rng.uniform(0.15, 0.5)

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        radius = reach[which]
        u, v = dx / radius, dy / radius
        body = inside(u, v, which)
        top = smoothstep(0.0, plateau, body) + 0.3 * level[which]
        top = top + u * lean[0][which] + v * lean[1][which]
        return np.where(body > 0.0, radius * top, -np.inf)

    stone, index = splat(canvas, x, y, reach, profile, -np.inf)
    tar = noise(canvas, "tar", Spectrum(2.0 * size, 0.008, slope=1.1))
    fill = size * (rng.uniform(0.0, 0.45) + 0.14 * tar)
    out = smoothstep(-0.06 * size, 0.06 * size, np.maximum(stone, -size) - fill)
    height = np.maximum(stone, fill)
    each = own.random(count)[index]
    grit = noise(canvas, "grit", Spectrum(0.03, 0.006, slope=0.4))
    diffuse = pick(tones, each) * np.exp(0.12 * grit)
    diffuse = mix(binder[:, None, None] * np.exp(0.2 * grit), diffuse, out)
    rough_stone = rng.uniform(0.35, 0.85) + 0.1 * own.standard_normal(count)[index]
    rough = mix(rng.uniform(0.35, 0.9) + 0.04 * grit, rough_stone, out)
    height = height + 0.03 * size * grit
    return SurfaceFields(diffuse, rng.dielectric(), rough, height, 1.0 - out)


def terrazzo(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Chips of stone in cement, ground flat and polished."""
    size = rng.log_uniform(0.03, 0.14)
    tones = _mixed(rng, 0.25)
    cement = rng.natural(STONES)
    sparse, power = rng.uniform(0.45, 0.9), rng.uniform(0.8, 3.0)

    x, y, sizes = scatter(canvas, "chips", sparse * size)
    count = x.size
    reach = 0.6 * size * sizes.random(count) ** power + 0.06 * size
    own = canvas.stream("own")
    inside = polygons(own, count, 6, 1.0)
    level, long = own.random(count), np.exp(0.35 * np.abs(own.standard_normal(count)))
    turn = own.uniform(0.0, np.pi, count)

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = rotated(dx, dy, turn[which])
        radius = reach[which]
        within = inside(u / radius, long[which] * v / radius, which)
        return np.where(within > 0.0, level[which] * 10.0 + np.minimum(within, 0.3), -np.inf)

    _, index = splat(canvas, x, y, reach, profile, 0.0)
    chip = (index >= 0).astype(np.float64)
    vein = noise(canvas, "vein", Spectrum(0.06, 0.007, slope=0.9))
    diffuse = pick(tones, own.random(count)[index]) * np.exp(rng.uniform(0, 0.2) * vein)
    diffuse = np.where(index >= 0, diffuse, cement[:, None, None] * np.exp(0.08 * vein))
    polish, dull = rng.log_uniform(0.08, 0.4), rng.uniform(0.0, 0.25)
    rough = polish + dull * (1.0 - chip) + 0.04 * own.standard_normal(count)[index] * chip
    pit = smoothstep(1.9, 2.4, noise(canvas, "pits", Spectrum(0.03, 0.007, slope=0.0)))
    height = 0.1 * chip - 0.6 * pit + 0.06 * noise(canvas, "wave", Spectrum(0.16, 0.08))
    rough = rough + 0.3 * pit
    return SurfaceFields(
        diffuse, rng.uniform(0.038, 0.06), rough, size * height, np.maximum(pit, 0.3 * (1 - chip))
    )


def marble(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Polished stone with clouds and veins."""
    size = rng.log_uniform(0.08, 0.16)
    stone, vein_hue = rng.natural(STONES), rng.natural(STONES)
    stretch, turn = rng.log_uniform(1.0, 3.0), rng.uniform(0.0, np.pi)
    cloud = noise(canvas, "cloud", Spectrum(2.0 * size, 0.01, 1.6, stretch, turn))
    vein = np.zeros_like(cloud)
    for k in range(int(rng.integers(1, 4))):
        field = noise(canvas, f"vein {k}", Spectrum(1.5 * size, 0.008, 1.7, stretch, turn))
        here = smoothstep(-0.8, 1.2, noise(canvas, f"here {k}", Spectrum(0.16, 0.06)))
        width = rng.log_uniform(0.03, 0.15)
        vein = np.maximum(vein, here * np.exp(-((field / width) ** 2)))
    ground = stone[:, None, None] * np.exp(rng.uniform(0.05, 0.4) * cloud)
    diffuse = mix(ground, vein_hue[:, None, None], rng.uniform(0.3, 1.0) * vein)
    grain = noise(canvas, "crystals", Spectrum(0.02, 0.006, slope=0.2))
    diffuse = diffuse * np.exp(rng.uniform(0.0, 0.15) * grain)
    rough = rng.log_uniform(0.08, 0.4) + rng.uniform(-0.05, 0.15) * vein + 0.01 * grain
    wave = noise(canvas, "wave", Spectrum(0.16, 0.05, slope=1.2))
    height = 0.002 * wave - rng.uniform(0.0, 0.002) * vein
    return SurfaceFields(diffuse, rng.uniform(0.038, 0.06), rough, height, rng.random() * vein)


def pitted(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Stone or concrete with pits and pores: travertine, lava, blown concrete."""
    size = rng.log_uniform(0.025, 0.12)
    stone = rng.natural(STONES)
    spread, dense = rng.uniform(0.3, 0.9), rng.uniform(0.5, 1.1)
    steep = rng.uniform(0.5, 2.0)
    stretch, turn = rng.log_uniform(1.0, 2.5), rng.uniform(0.0, np.pi)

    x, y, sizes = scatter(canvas, "pits", dense * size)
    reach = 0.5 * size * np.exp(-spread * np.abs(sizes.standard_normal(x.size)))
    inside = polygons(canvas.stream("own"), x.size, 6, 0.7)

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = rotated(dx, dy, np.full(x.size, turn)[which])
        radius = reach[which]
        u, v = u / radius, stretch * v / radius
        body = mix(1.0 - np.hypot(u, v), inside(u, v, which), np.array(0.4))
        return np.where(body > 0.0, radius * smoothstep(0.0, 1.0 / steep, body), -np.inf)

    deep, _ = splat(canvas, x, y, reach, profile, 0.0)
    crumb = noise(canvas, "crumb", Spectrum(0.7 * size, 0.008, slope=1.0))
    swell = noise(canvas, "swell", Spectrum(0.16, 0.05, slope=1.5))
    height = -deep + 0.02 * size * rng.uniform(0.2, 1.5) * crumb + 0.03 * size * swell
    other = rng.shade(stone, 0.5, 0.15)
    bed = noise(canvas, "bed", Spectrum(0.15, 0.012, 1.2, stretch, turn))
    sharp = rng.log_uniform(0.8, 3.0)
    diffuse = mix(stone[:, None, None], other[:, None, None], smoothstep(-sharp, sharp, bed))
    diffuse = diffuse * np.exp(0.08 * crumb)
    hole = smoothstep(0.0, 0.25 * size, deep)
    polished = rng.chance(0.3)
    rough = (rng.uniform(0.12, 0.35) if polished else rng.uniform(0.5, 0.9)) + 0.02 * crumb
    rough = rough + (0.5 if polished else 0.05) * hole
    return SurfaceFields(diffuse, rng.dielectric(), rough, height, hole)


# Bricks and setts laid in bonds and herringbone, with mortar or sand between them.


@dataclass(frozen=True)
class _Bricks:
    """Brick of each texel, and coordinates within it in units of the brick's width."""

    name: tuple[Integers, Integers]
    """Two (H, W) integers that identify the brick."""
    along: Raster
    across: Raster
    """(H, W) coordinates from the brick's first corner."""
    length: Raster | float
    """Length of a brick, whose width is 1."""


def bond(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Bricks in running, stack, English or basket bond."""
    size = rng.log_uniform(0.03, 0.12)
    along, across = frame(canvas, "bond", rng.angle(), 5.0 * size, 0.0)
    u, v = along / size, across / size
    pattern = rng.integers(4)
    ratio = float(rng.choice([1.0, 1.5, 2.0, 3.0, 4.0]))
    if pattern == 3:
        return _wall(canvas, rng, size, _blocks(u, v, int(rng.integers(2, 4))))
    row = np.floor(v).astype(np.int64)
    length: Raster | float = ratio
    if pattern == 0:
        start = row * rng.choice([0.5, 1.0 / 3.0, 0.25, 0.5])
    elif pattern == 1:
        start = 0.0 * row
    else:  # headers in every other course
        length = np.where(row % 2 == 0, 2.0, 1.0)
        start = np.where(row % 2 == 0, 0.0, 0.25 * 2.0)
    place = u / length + start
    column = np.floor(place).astype(np.int64)
    bricks = _Bricks((row, column), (place - column) * length, v - row, length)
    return _wall(canvas, rng, size, bricks)


def _blocks(u: Raster, v: Raster, side: int) -> _Bricks:
    """Squares of `side` parallel bricks, alternately rotated by 90 degrees (basket bond)."""
    block_u, block_v = np.floor(u / side).astype(np.int64), np.floor(v / side).astype(np.int64)
    lying = (block_u + block_v) % 2 == 0
    inner_u, inner_v = u - side * block_u, v - side * block_v
    across = np.where(lying, inner_v, inner_u)
    which = np.floor(across).astype(np.int64)
    return _Bricks(
        (block_u * side + which, block_v),
        np.where(lying, inner_u, inner_v),
        across - which,
        float(side),
    )


def herringbone(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Herringbone of bricks or parquet blocks, two to five times as long as wide."""
    size = rng.log_uniform(0.025, 0.08)
    along, across = frame(canvas, "herringbone", rng.angle() + np.pi / 4, 5.0 * size, 0.0)
    u, v = along / size, across / size
    length = int(rng.integers(2, 6))
    i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    k = (i - j) % (2 * length)
    lying = k < length
    back = 2 * length - 1 - k
    name = (2 * np.where(lying, i - k, i) + lying, np.where(lying, j, j - back))
    bricks = _Bricks(
        name, np.where(lying, k + u - i, back + v - j), np.where(lying, v - j, u - i), float(length)
    )
    return _wall(canvas, rng, size, bricks)


def _wall(canvas: Canvas, rng: Draws, size: float, bricks: _Bricks) -> SurfaceFields:
    wobble = noise(canvas, "wobble", Spectrum(0.6 * size, min(0.008, 0.2 * size), slope=1.1))
    joint, corner = rng.log_uniform(0.02, 0.12), rng.uniform(0.02, 0.2)
    # Distance inside a rounded rectangle.
    over_u = np.maximum(corner + joint - np.minimum(bricks.along, bricks.length - bricks.along), 0)
    over_v = np.maximum(corner + joint - np.minimum(bricks.across, 1.0 - bricks.across), 0)
    inside = corner - np.hypot(over_u, over_v) + rng.uniform(0.0, 0.03) * wobble
    body = smoothstep(-0.02, 0.03, inside)
    bevel = 1.0 - np.exp(-np.maximum(inside, 0.0) / rng.uniform(0.01, 0.08))

    def own(label: str) -> Raster:
        return 2.0 * cell_noise(canvas, label, *bricks.name) - 1.0

    unlevel = rng.uniform(0.0, 0.12)
    tilt = unlevel * (own("tilt u") * (bricks.along / bricks.length - 0.5))
    tilt = tilt + unlevel * own("tilt v") * (bricks.across - 0.5)
    crown = rng.uniform(0.0, 0.1) * (1.0 - 4.0 * (bricks.across - 0.5) ** 2)
    face = 0.2 * bevel + crown + tilt + 0.5 * unlevel * own("level")
    rugged = rng.uniform(0.0, 0.05)
    parquet = rng.chance(0.3)
    lengthwise = noise(canvas, "vein", Spectrum(0.6 * size, min(0.007, 0.2 * size), slope=0.7))
    face = face + rugged * (wobble + 0.5 * lengthwise)
    sand = noise(canvas, "sand", Spectrum(0.03, 0.006, slope=0.4))
    recess = rng.uniform(-0.05, 0.15)
    height = mix(0.1 - recess + 0.03 * sand, face + 0.05, body)
    palette = rng.choice(4)
    hue = rng.natural(WOODS if parquet else (CLAYS, CLAYS, STONES)[palette % 3])
    if palette == 3 and not parquet:
        hue = rng.dye()
    tones = rng.shades(hue, 12, rng.choice([0.06, 0.18, 0.35]))
    brick = pick(tones, 0.5 + 0.4999 * own("tone"))
    grain = _wood(canvas, bricks, rng.uniform(8.0, 14.0)) if parquet else wobble
    brick = brick * np.exp(rng.uniform(0.03, 0.2) * grain + 0.06 * lengthwise)
    mortar = rng.natural(STONES)[:, None, None] * np.exp(0.12 * sand)
    diffuse = mix(mortar, brick, body)
    glazed = parquet or rng.chance(0.25)
    gloss = rng.uniform(0.12, 0.4) if glazed else rng.uniform(0.45, 0.88)
    rough = mix(
        rng.uniform(0.7, 0.93) + 0.02 * sand, gloss + 0.05 * own("gloss") + 0.0 * sand, body
    )
    specular = mix(np.array(0.035), np.array(rng.dielectric()), body)
    return SurfaceFields(diffuse, specular, rough, size * height, 1.0 - body)


def _wood(canvas: Canvas, bricks: _Bricks, fine: float) -> Raster:
    """(H, W) grain along each block, in [-1, 1]."""
    slow = 0.25 * np.sin(2.0 * bricks.along + 6.0 * cell_noise(canvas, "bow", *bricks.name))
    coarse = value_noise(canvas, "coarse", 0.35 * fine * (bricks.across + slow), *bricks.name)
    return 0.6 * coarse + 0.6 * value_noise(
        canvas, "fine", fine * (bricks.across + slow), *bricks.name
    )
