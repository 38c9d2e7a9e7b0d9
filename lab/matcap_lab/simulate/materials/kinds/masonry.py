"""Bricks and setts laid in bonds and herringbone, with mortar or sand between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from matcap_lab.simulate.materials.draws import (
    CLAYS,
    STONES,
    WOODS,
    Draws,
    Integers,
    cell_noise,
    value_noise,
)
from matcap_lab.simulate.materials.kinds.place import frame
from matcap_lab.simulate.materials.kinds.surface_fields import SurfaceFields
from matcap_lab.simulate.procedural import Canvas, Raster, Spectrum, mix, noise, pick, smoothstep


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
        name,
        np.where(lying, k + u - i, back + v - j),
        np.where(lying, v - j, u - i),
        float(length),
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
