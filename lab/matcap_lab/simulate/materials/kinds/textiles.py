"""Textiles with yarns that show: knits, ribs, weaves, wickerwork."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from matcap_lab.simulate.materials.draws import WOODS, Draws, Integers, cell_noise, value_noise
from matcap_lab.simulate.materials.kinds.place import frame
from matcap_lab.simulate.materials.kinds.surface_fields import SurfaceFields
from matcap_lab.simulate.procedural import Canvas, Raster, Spectrum, mix, noise, pick, smoothstep


def _fuzz(canvas: Canvas, size: float) -> Raster:
    return noise(canvas, "fuzz", Spectrum(0.5 * size, min(0.007, 0.3 * size), slope=0.6))


def knit(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Stocking stitch: columns of Vs, each leg a bulging, twisted yarn."""
    size = rng.log_uniform(0.03, 0.12)
    along, across = frame(canvas, "knit", rng.angle(), 6.0 * size, size * rng.uniform(0.0, 0.12))
    course = rng.uniform(0.6, 0.95)
    u, v = across / size, along / (size * course)
    wale = np.floor(u).astype(np.int64)
    fold = np.abs(2.0 * (u - wale) - 1.0)
    strand = v + rng.uniform(0.8, 1.5) * fold
    row = np.floor(strand).astype(np.int64)
    side = 2.0 * (strand - row) - 1.0
    middle = 2.0 * fold - 1.0
    body = np.maximum(1.0 - 0.92 * side**2 - 0.75 * middle**2, 0.0)
    height = np.sqrt(body)
    leg = (u - wale > 0.5).astype(np.int64)
    twist = np.sin(2.0 * np.pi * (rng.uniform(1.0, 2.5) * fold + rng.uniform(0.5, 1.5) * side))
    fuzz = _fuzz(canvas, size)
    height = height + 0.06 * rng.random() * twist + 0.04 * rng.random() * fuzz
    tones = rng.shades(rng.dye(), 8, rng.choice([0.03, 0.12]))
    striped = rng.chance(0.3)
    share = cell_noise(canvas, "row", row // int(rng.integers(1, 5))) if striped else 0.0 * u
    mottled = rng.log_uniform(0.01, 0.12)
    own = cell_noise(canvas, "stitch", row, wale, leg) - 0.5
    diffuse = pick(tones, share) * np.exp(mottled * fuzz + 0.15 * own + 0.05 * twist)
    if striped and rng.chance(0.5):
        second = rng.dye()[:, None, None]
        diffuse = np.where(share < 0.4, second * np.exp(mottled * fuzz), diffuse)
    rough = rng.uniform(0.5, 0.92) + 0.03 * fuzz
    return SurfaceFields(
        diffuse, rng.dielectric(), rough, size * 0.5 * height, 1.0 - np.sqrt(height.clip(0, 1))
    )


def cable(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Cables of two or three strands that cross, between columns of purl bumps."""
    size = rng.log_uniform(0.06, 0.16)
    along, across = frame(canvas, "cable", rng.angle(), 4.0 * size, size * rng.uniform(0.0, 0.08))
    u = across / size
    column = np.floor(u).astype(np.int64)
    x = 2.0 * (u - column) - 1.0
    strands = int(rng.integers(2, 4))
    theta = 2.0 * np.pi * along / (size * rng.uniform(0.9, 2.2))
    theta = theta + np.where(rng.chance(0.5), np.pi * (column % 2), 0.0)
    stitch = size * rng.uniform(0.12, 0.25)
    fibre, height = np.zeros_like(u), np.full_like(u, -1.0)
    thick = 0.75 / strands
    for k in range(strands):
        phase = theta + 2.0 * np.pi * k / strands
        centre = 0.42 * np.sin(phase)
        rise = 0.18 * (np.cos(phase) if strands == 2 else np.sin(2.0 * phase))
        side = (x - centre) / thick
        body = 1.0 - side**2
        high = np.where(body > 0.0, thick * np.sqrt(np.maximum(body, 0.0)) + rise, -1.0)
        lean = 0.6 * np.abs(side)
        fibre = np.where(high > height, along / stitch + lean + 0.37 * k, fibre)
        height = np.maximum(height, high)
    purl = 0.06 * np.cos(2.0 * np.pi * along / stitch) * np.cos(np.pi * x) ** 2 - 0.1
    between = height < purl
    ridge = np.abs(np.sin(np.pi * fibre))
    height = np.where(between, purl, height + rng.uniform(0.04, 0.12) * ridge)
    fuzz = _fuzz(canvas, stitch * 2.0)
    height = height + 0.015 * fuzz
    colour = rng.dye()[:, None, None]
    diffuse = colour * np.exp(
        rng.log_uniform(0.01, 0.12) * fuzz + 0.1 * np.where(between, 0.0, ridge)
    )
    cavity = smoothstep(0.35, -0.12, height)
    return SurfaceFields(
        diffuse, rng.dielectric(), rng.uniform(0.55, 0.92) + 0.02 * fuzz, size * height, cavity
    )


def ribs(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Corduroy and other ribs: rounded ridges of pile, wide or narrow by turns."""
    size = rng.log_uniform(0.02, 0.12)
    turn = rng.angle()
    along, across = frame(canvas, "ribs", turn, 8.0 * size, size * rng.uniform(0.0, 0.12))
    u = across / size
    rib = np.floor(u).astype(np.int64)
    x = 2.0 * (u - rib) - 1.0
    gap = rng.uniform(0.05, 0.35)
    narrow = np.where(rng.chance(0.3) & (rib % 2 == 0), 0.75, 1.0)
    body = np.maximum(1.0 - (np.abs(x) / (narrow * (1.0 - gap))) ** rng.uniform(2.0, 4.0), 0.0)
    height = np.sqrt(body)
    spectrum = Spectrum(0.04, 0.006, 0.6, stretch=rng.uniform(1.0, 4.0), angle=turn + np.pi / 2)
    pile = noise(canvas, "pile", spectrum)
    crushed = noise(canvas, "crushed", Spectrum(0.16, 0.05))
    height = height * (1.0 + 0.1 * rng.random() * crushed) + rng.uniform(0.0, 0.12) * pile * body
    if rng.chance(0.4):  # bars across the ribs
        bar = np.sin(2.0 * np.pi * along / (size * rng.uniform(0.3, 0.8)) + np.pi * (rib % 2))
        height = height + 0.12 * bar * body
    colour = rng.dye()[:, None, None]
    sheen = rng.uniform(0.0, 0.2)
    diffuse = colour * np.exp(rng.uniform(0.02, 0.14) * pile + sheen * crushed)
    rough = rng.uniform(0.45, 0.92) - 0.2 * sheen * crushed + 0.03 * pile
    return SurfaceFields(
        diffuse, rng.dielectric(), rough, 0.4 * size * height, (1.0 - height).clip(0, 1)
    )


# Draft of a weave: threads over, under, shift from thread to thread, whether it zigzags.
_Draft = tuple[int, int, int, bool]


def weave(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Plain, twill and satin weaves of round yarns."""
    size = rng.log_uniform(0.014, 0.06)
    drafts = [
        (2, 1, 1),
        (2, 2, 1),
        (3, 1, 1),
        (1, 3, 1),
        (4, 1, 2),
        (1, 4, 2),
        (3, 3, 1),
        (1, 1, 1),
    ]
    over, under, step = drafts[rng.integers(len(drafts))]
    return _woven(canvas, rng, size, (over, under, step, rng.chance(0.3)), 1, Draws.dye)


def basket(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Basket weave: groups of yarns or flat canes over and under each other."""
    size = rng.log_uniform(0.014, 0.05)
    together = int(rng.integers(1, 5))
    if together == 1:
        size = size * 2.5

    def hue(rng: Draws) -> Raster:
        return rng.natural(WOODS) if rng.chance(0.6) else rng.dye()

    return _woven(canvas, rng, size, (1, 1, 1, False), together, hue)


def _woven(
    canvas: Canvas,
    rng: Draws,
    size: float,
    draft: _Draft,
    together: int,
    hue: Callable[[Draws], Raster],
) -> SurfaceFields:
    over, under, step, zigzag = draft
    along, across = frame(canvas, "weave", rng.angle(), 8.0 * size, size * rng.uniform(0.0, 0.15))
    u, v = along / size, across / (size * rng.log_uniform(0.8, 1.25))
    column, row = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    turn = int(rng.integers(6, 20))

    def on_top(i: Integers, j: Integers) -> Raster:
        i, j = i // together, j // together
        if zigzag:
            i = np.abs(i % (2 * turn) - turn)
        return np.where((i + step * j) % (over + under) < over, 1.0, -1.0)

    below, left = np.floor(v - 0.5).astype(np.int64), np.floor(u - 0.5).astype(np.int64)
    depth = rng.uniform(0.2, 0.45) * together**0.5
    across_u, across_v = (smoothstep(0.1, 0.9, w) for w in (v - 0.5 - below, u - 0.5 - left))
    rise_u = depth * mix(on_top(column, below), on_top(column, below + 1), across_u)
    rise_v = -depth * mix(on_top(left, row), on_top(left + 1, row), across_v)
    fill, flat = rng.uniform(0.82, 1.0), rng.uniform(2.0, 4.0)
    side_u, side_v = (2.0 * (w - np.floor(w)) - 1.0 for w in (u, v))

    def round_(side: Raster) -> Raster:
        body = 1.0 - (np.abs(side) / fill) ** flat
        return np.where(body > 0.0, 0.45 * np.sqrt(np.maximum(body, 0.0)), -1.0)

    high_u, high_v = rise_u + round_(side_u), rise_v + round_(side_v)
    upper = high_u >= high_v
    height = np.maximum(np.maximum(high_u, high_v), -0.5)
    side, length = np.where(upper, side_u, side_v), np.where(upper, v, u)
    thread = np.where(upper, 2 * column, 2 * row + 1)
    ply = int(rng.integers(1, 4))
    twist = np.sin(2.0 * np.pi * (ply * length + rng.uniform(0.4, 1.0) * side))
    twist = twist * (size > 0.02) * rng.uniform(0.0, 1.0)
    fuzz = _fuzz(canvas, size)
    lines = value_noise(canvas, "lines", side * rng.uniform(3.0, 6.0), thread)
    height = height + 0.05 * twist + 0.03 * lines
    warp_hue = hue(rng)
    weft_hue = rng.shade(warp_hue, 0.4) if rng.chance(0.6) else hue(rng)
    spread = rng.choice([0.03, 0.1, 0.3])
    tone = spread * (2.0 * cell_noise(canvas, "dye", thread) - 1.0)
    diffuse = np.where(upper, warp_hue[:, None, None], weft_hue[:, None, None])
    if rng.chance(0.2):  # stripes or a plaid
        band = (thread // 2) // int(rng.integers(3, 12)) % 2 == 0
        diffuse = np.where(band & (upper | rng.chance(0.5)), rng.dye()[:, None, None], diffuse)
    diffuse = diffuse * np.exp(tone + rng.uniform(0.02, 0.12) * (fuzz + lines) + 0.06 * twist)
    sheen = rng.uniform(0.3, 0.9)
    rough = sheen + rng.uniform(-0.08, 0.08) * upper + 0.05 * tone + 0.02 * fuzz
    cavity = smoothstep(0.2, -0.45, height)
    return SurfaceFields(diffuse, rng.dielectric(), rough, size * height, cavity)
