"""Wood, textiles, and sheets: felt, carpet, paper, foil, tread plate."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from matcap_lab.simulate.kinds.surface import (
    SurfaceFields,
    frame,
    paths,
    polygons,
    rotated,
    scatter,
    splat,
)
from matcap_lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    bumps,
    cells,
    mix,
    noise,
    pick,
    smoothstep,
)
from matcap_lab.simulate.varied import METALS, WOODS, Draws, Integers, cell_noise, value_noise


def planks(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Boards side by side, each with its own rings, pores and tone."""
    wide, long = rng.log_uniform(0.07, 0.2), rng.uniform(4.0, 10.0)
    turn = rng.angle()
    along, across = frame(canvas, "planks", turn, 1.0, 0.0)
    v = across / wide
    row = np.floor(v).astype(np.int64)
    u = along / (wide * long) + cell_noise(canvas, "start", row)
    board = (row, np.floor(u).astype(np.int64))
    own = cell_noise(canvas, "own", *board)

    # Grain: rings cut at a slant, so that they run along and now and then close in an arch.
    slow = Spectrum(0.16, 0.05, 1.5, stretch=rng.uniform(4.0, 8.0), angle=turn)
    bow = noise(canvas, "bow", slow) * (2.0 * cell_noise(canvas, "side", *board) - 1.0)
    pitch = rng.log_uniform(0.012, 0.035)
    rings = (across + rng.uniform(0.02, 0.09) * bow) / pitch + 40.0 * own
    late = (rings - np.floor(rings)) ** rng.uniform(1.5, 4.0)
    late = late * smoothstep(1.0, 0.9, rings - np.floor(rings))
    late = late * (0.6 + 0.4 * value_noise(canvas, "year", rings))
    fibre = noise(canvas, "fibre", Spectrum(0.03, 0.005, 0.6, stretch=18.0, angle=turn))
    pore = smoothstep(1.3, 2.2, noise(canvas, "pores", Spectrum(0.012, 0.0045, 0.1, 10.0, turn)))
    pore = pore * rng.uniform(0.0, 1.0)

    joint = rng.log_uniform(0.003, 0.012)
    edge = np.minimum(v - row, 1.0 + row - v) * wide
    end = np.minimum(u - board[1], 1.0 + board[1] - u) * wide * long
    edge = np.minimum(edge, end)
    body = smoothstep(0.3 * joint, joint, edge)
    bevel = rng.uniform(0.0, 2.0) * joint * (1.0 - np.exp(-edge / (1.5 * joint)))
    cup = 0.02 * wide * (2.0 * own - 1.0) * (2.0 * (v - row) - 1.0) ** 2
    rough_sawn = rng.uniform(0.0, 0.0012)
    height = cup + bevel + body * 1.5 * joint * rng.uniform(0.3, 1.0)
    height = height + rough_sawn * (fibre - 1.5 * (1.0 - late)) - 0.001 * pore

    hue = rng.natural(WOODS)
    tones = rng.shades(hue, 10, rng.uniform(0.03, 0.3))
    diffuse = pick(tones, cell_noise(canvas, "tone", *board))
    ink = rng.uniform(0.3, 1.2)
    diffuse = diffuse * np.exp(-ink * late + 0.07 * fibre - 0.8 * pore)
    diffuse = diffuse * np.array([1.0, 0.95, 0.85])[:, None, None] ** (late + 0.0 * fibre)
    varnished = rng.chance(0.5)
    gloss = rng.uniform(0.15, 0.4) if varnished else rng.uniform(0.5, 0.85)
    rough = gloss + (0.03 if varnished else 0.1) * (0.5 - late) + 0.02 * fibre + 0.15 * pore
    return SurfaceFields(
        diffuse, rng.dielectric(), rough, height, np.maximum(1.0 - body, 0.4 * pore)
    )


def varnish(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Scratches, straight and curved, in a glossy coat over wood or paint."""
    coat = rng.natural(WOODS) if rng.chance(0.6) else rng.dye()
    grain_turn = rng.angle()
    grain = noise(canvas, "wood", Spectrum(0.08, 0.006, 0.9, stretch=12.0, angle=grain_turn))
    contrast = rng.uniform(0.0, 0.35)
    favoured, loose = rng.uniform(0.0, np.pi), rng.choice([0.15, 0.6, 3.0])
    width = rng.log_uniform(0.0025, 0.006)

    pitch = rng.log_uniform(0.05, 0.15)
    step = rng.uniform(0.01, 0.04)
    x, y, turn, whose = paths(canvas, "scratches", pitch, 12, step, 0.05, (favoured, loose))
    reach = np.full(x.size, 0.5 * step + 3.0 * width)
    own = canvas.stream("own")
    force = own.random(x.size + 1)
    thick = width * (0.5 + own.random(x.size + 1))

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        chain = whose[which]
        u, v = rotated(dx, dy, turn[which])
        half = reach[which] - 3.0 * width
        far = np.hypot(np.maximum(np.abs(u) - half, 0.0), v) / thick[chain]
        depth = (0.25 + 0.75 * force[chain]) * np.exp(-(far**2))
        return np.where(depth > 0.02, depth, -np.inf)

    scratch, _ = splat(canvas, x, y, reach, profile, 0.0)
    wave = noise(canvas, "orange peel", Spectrum(0.05, 0.02))
    height = -0.5 * width * scratch + rng.uniform(0.0, 0.15) * width * wave
    pale = rng.uniform(-0.5, 0.9)
    diffuse = coat[:, None, None] * np.exp(contrast * grain + pale * scratch)
    worn = noise(canvas, "worn", Spectrum(0.16, 0.03, slope=1.3))
    rough = rng.log_uniform(0.1, 0.3) + rng.uniform(0.1, 0.4) * scratch
    rough = rough + rng.uniform(0.0, 0.05) * worn
    return SurfaceFields(diffuse, rng.uniform(0.038, 0.055), rough, height, scratch)


def chipboard(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Long flakes of wood pressed on one another in all directions."""
    size = rng.log_uniform(0.06, 0.16)
    hue = rng.natural(WOODS)
    slender, spread = rng.uniform(0.25, 0.5), rng.uniform(0.3, 1.5)
    favoured = rng.angle()

    x, y, sizes = scatter(canvas, "flakes", 0.38 * size)
    count = x.size
    reach = size * (0.4 + 0.6 * sizes.random(count))
    own = canvas.stream("own")
    turn = favoured + spread * own.standard_normal(count)
    level, lean = own.random(count), 0.25 * own.standard_normal((2, count))
    skew = 0.4 * own.standard_normal(count)
    wide = slender * (0.5 + own.random(count))

    def place(dx: Raster, dy: Raster, which: Integers) -> tuple[Raster, Raster]:
        u, v = rotated(dx, dy, turn[which])
        radius = reach[which]
        return u / radius, v / (radius * wide[which])

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = place(dx, dy, which)
        inside = np.minimum(0.92 - np.abs(u + skew[which] * 0.3 * v), 0.9 - np.abs(v))
        high = level[which] * 1.6 + lean[0][which] * u + lean[1][which] * v * 0.5
        return np.where(inside > 0.0, high, -np.inf)

    height, index = splat(canvas, x, y, reach, profile, -0.5)
    index = np.maximum(index, 0)
    u, v = place(canvas.x - x[index], canvas.y - y[index], index)
    fine = rng.uniform(4.0, 9.0)
    lines = value_noise(canvas, "lines", fine * (v + 0.15 * np.sin(3.0 * u)), index)
    lines = 0.6 * lines + 0.5 * value_noise(canvas, "broad", 0.35 * fine * v, index)
    tones = rng.shades(hue, 12, rng.uniform(0.12, 0.4))
    diffuse = pick(tones, own.random(count)[index])
    diffuse = diffuse * np.exp(rng.uniform(0.05, 0.3) * lines)
    rough = rng.uniform(0.35, 0.85) + 0.06 * own.standard_normal(count)[index] + 0.03 * lines
    cavity = smoothstep(1.2, -0.1, height)
    return SurfaceFields(
        diffuse, rng.dielectric(), rough, 0.1 * size * (height + 0.06 * lines), cavity
    )


def scales(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Flakes that lift at their rims: rust, bark, shale."""
    size = rng.log_uniform(0.04, 0.15)
    rusty = rng.chance(0.6)
    hue = rng.shade(np.array([0.26, 0.10, 0.035]), 0.4) if rusty else rng.natural(WOODS)
    under = rng.shade(hue * 0.45, 0.3, 0.1)
    curl = rng.uniform(-0.1, 0.5)

    x, y, sizes = scatter(canvas, "flakes", 0.5 * size)
    count = x.size
    reach = size * (0.25 + 0.5 * sizes.random(count))
    own = canvas.stream("own")
    inside = polygons(own, count, 7, 0.9)
    level, lean = own.random(count), 0.5 * own.standard_normal((2, count))

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        radius = reach[which]
        u, v = dx / radius, dy / radius
        body = inside(u, v, which)
        high = level[which] * 1.5 + 0.3 * (lean[0][which] * u + lean[1][which] * v)
        high = high + curl * (1.0 - np.clip(body, 0.0, 1.0)) ** 3
        return np.where(body > 0.0, high, -np.inf)

    height, index = splat(canvas, x, y, reach, profile, -0.3)
    crumb = noise(canvas, "crumb", Spectrum(0.4 * size, 0.007, slope=0.7))
    tones = rng.shades(hue, 12, rng.uniform(0.15, 0.4))
    diffuse = pick(tones, own.random(count)[index]) * np.exp(0.15 * crumb)
    depth = smoothstep(0.9, -0.2, height)
    diffuse = mix(diffuse, under[:, None, None], 0.8 * depth)
    rough = rng.uniform(0.5, 0.9) + 0.07 * own.standard_normal(count)[index] + 0.03 * crumb
    height = 0.15 * size * (height + 0.08 * crumb)
    return SurfaceFields(diffuse, rng.dielectric(), rough, height, depth)


# Textiles with yarns that show: knits, ribs, weaves, wickerwork.


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


# Sheets: felt, looped carpet, paper, creased foil or cloth, tread plate.


def felt(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Wavy fibres over one another: felt, fleece, coir."""
    width = rng.log_uniform(0.005, 0.012)
    pieces, step = 14, width * rng.uniform(1.5, 3.5)
    curl, loose = rng.uniform(0.1, 0.5), rng.choice([0.3, 3.0, 3.0])
    favoured = rng.uniform(0, np.pi)

    pitch = np.sqrt(width * pieces * step) * rng.uniform(0.75, 1.1)
    x, y, turn, whose = paths(canvas, "fibres", pitch, pieces, step, curl, (favoured, loose))
    reach = np.full(x.size, 0.5 * step + 1.5 * width)
    own = canvas.stream("own")
    count = int(whose.max()) + 1
    level, slant = own.random(count), own.standard_normal(count)
    thick = width * (0.6 + 0.8 * own.random(count))
    order = np.arange(x.size) % pieces / (pieces - 1.0) - 0.5

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = rotated(dx, dy, turn[which])
        chain = whose[which]
        far = np.hypot(np.maximum(np.abs(u) - 0.5 * step, 0.0), v) / thick[chain]
        place = order[which] + u / (pieces * step)
        high = width * (2.5 * level[chain] + 1.5 * slant[chain] * place)
        high = high + thick[chain] * np.sqrt(np.maximum(1.0 - far**2, 0.0))
        return np.where(far < 1.0, high, -np.inf)

    height, index = splat(canvas, x, y, reach, profile, -width)
    fibre = whose[index]
    tones = rng.shades(rng.dye(), 9, rng.choice([0.05, 0.2, 0.5]))
    if rng.chance(0.2):
        tones = np.concatenate([tones, rng.shades(rng.dye(), 5, 0.2)])
    diffuse = pick(tones, own.random(count)[fibre])
    rough = rng.uniform(0.5, 0.92) + 0.03 * own.standard_normal(count)[fibre]
    cavity = smoothstep(3.0 * width, -1.0 * width, height)
    return SurfaceFields(diffuse, rng.dielectric(), rough, height, cavity)


def loops(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Tufts in loose rows, each a small arch of yarn: carpet, terry, boucle."""
    size = rng.log_uniform(0.018, 0.06)
    thick = rng.uniform(0.28, 0.45)
    favoured, loose = rng.uniform(0.0, np.pi), rng.choice([0.25, 0.8, 3.0])

    x, y, sizes = scatter(canvas, "tufts", size * rng.uniform(0.55, 0.8))
    count = x.size
    reach = size * (0.8 + 0.4 * sizes.random(count))
    own = canvas.stream("own")
    turn = favoured + loose * own.standard_normal(count)
    level, bow = 0.5 * own.random(count), 0.3 * own.standard_normal(count)

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = rotated(dx, dy, turn[which])
        u, v = u / reach[which], v / reach[which]
        far = (v - bow[which] * (1.0 - u * u)) / thick
        arch = 1.0 - u * u
        body = 1.0 - far * far
        high = 0.9 * np.sqrt(np.maximum(arch, 0.0)) + thick * np.sqrt(np.maximum(body, 0.0))
        return np.where((arch > 0.0) & (body > 0.0), high + level[which], -np.inf)

    height, index = splat(canvas, x, y, reach, profile, 0.0)
    index = np.maximum(index, 0)
    u, v = rotated(canvas.x - x[index], canvas.y - y[index], turn[index])
    twist = np.sin((u / size + v / size) * rng.uniform(8.0, 16.0)) * (size > 0.03)
    tones = rng.shades(rng.dye(), 9, rng.choice([0.03, 0.12, 0.35]))
    if rng.chance(0.3):
        tones = np.concatenate([tones, rng.shades(rng.dye(), 3, 0.1)])
    diffuse = pick(tones, own.random(count)[index]) * np.exp(0.06 * twist)
    rough = rng.uniform(0.55, 0.92) + 0.04 * own.standard_normal(count)[index]
    cavity = smoothstep(1.2, 0.1, height)
    return SurfaceFields(diffuse, rng.dielectric(), rough, size * (height + 0.03 * twist), cavity)


def tread(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """A repeated embossed motif: tread plate, studded rubber, embossed card."""
    size = rng.log_uniform(0.04, 0.15)
    along, across = frame(canvas, "tread", rng.angle(), 4.0 * size, 0.0)
    u, v = along / size, across / size
    brick = rng.chance(0.5)
    row = np.floor(v).astype(np.int64)
    u = u + 0.5 * (row % 2) * brick
    column = np.floor(u).astype(np.int64)
    x, y = 2.0 * (u - column) - 1.0, 2.0 * (v - row) - 1.0
    crossed = (column + row) % 2 == 0
    x, y = np.where(crossed, x, y), np.where(crossed, y, x)
    large, edge = rng.uniform(0.5, 0.8), rng.uniform(0.05, 0.4)
    motif = rng.integers(5)
    if motif == 0:  # lens-shaped bars
        far = np.maximum(np.abs(x) / 0.9, (np.abs(y) / (0.35 * large) + x * x) * 0.8)
    elif motif == 1:  # studs
        far = np.hypot(x, y) / large
    elif motif == 2:  # pyramids
        far = np.maximum(np.abs(x), np.abs(y)) / large
    elif motif == 3:  # diamonds
        far = (np.abs(x) + 0.6 * np.abs(y)) / large
    else:  # rings
        far = np.abs(np.hypot(x, y) - 0.6) / (0.35 * large)
    raised = smoothstep(0.0, edge, 1.0 - far) * (1.0 if rng.chance(0.75) else -1.0)
    metal = rng.chance(0.4)
    hue = rng.natural(METALS) if metal else rng.dye()
    dirt = noise(canvas, "dirt", Spectrum(0.15, 0.015, slope=1.2))
    low = smoothstep(0.4, -0.2, raised) if raised.max() > 0.0 else smoothstep(-0.4, -1.0, raised)
    worn = rng.uniform(0.0, 0.2)
    diffuse = hue[:, None, None] * np.exp(rng.uniform(0.02, 0.25) * dirt)
    specular = rng.uniform(0.5, 0.85) if metal else rng.dielectric()
    gloss = rng.uniform(0.15, 0.45) if metal else rng.uniform(0.15, 0.85)
    return SurfaceFields(diffuse, specular, gloss + 0.03 * dirt + worn * low, size * raised, low)


def paper(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Flat stock with flecks and cloudy formation: paper, card, vinyl."""
    stock = np.clip(rng.dye() if rng.chance(0.5) else rng.shade(np.full(3, 0.7), 0.15), 0.02, 0.88)
    cloud = noise(canvas, "cloud", Spectrum(0.05, 0.015, slope=0.8))
    length = rng.log_uniform(4.0, 10.0)
    flock = np.full((canvas.height, canvas.width), -4.0)
    start = rng.uniform(0.0, np.pi)
    for k in range(5):
        spectrum = Spectrum(0.02, 0.005, 0.2, stretch=length, angle=start + k * np.pi / 5)
        flock = np.maximum(flock, noise(canvas, f"flock {k}", spectrum))
    fleck = smoothstep(2.2, 2.8, noise(canvas, "fleck", Spectrum(0.02, 0.006, slope=0.0)))
    ink = rng.shade(stock, 1.0, 0.4)[:, None, None]
    share = rng.choice([0.0, 0.8]) * fleck
    diffuse = stock[:, None, None] * np.exp(rng.uniform(0.01, 0.08) * (cloud + flock))
    diffuse = diffuse + share * (ink - diffuse)
    rough = rng.choice([rng.uniform(0.15, 0.4), rng.uniform(0.5, 0.9)]) + 0.015 * flock
    height = 0.3 * cloud * rng.random() + rng.uniform(0.2, 1.0) * flock
    if rng.chance(0.3):  # laid or embossed
        _, across = frame(canvas, "laid", rng.uniform(0.0, np.pi), 0.5, 0.0)
        height = height + 1.2 * np.sin(2.0 * np.pi * across / rng.log_uniform(0.015, 0.05))
    cavity = smoothstep(0.0, -2.0, height)
    return SurfaceFields(diffuse, rng.dielectric(), rough, 0.002 * height, cavity)


def creased(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """A sheet crumpled into facets and smoothed again: paper, foil, cloth."""
    size = rng.log_uniform(0.06, 0.16)
    height = _facets(canvas, "large", 1.6 * size)
    for k, share in enumerate(rng.uniform(0.1, 0.7, size=2)):
        height = height + 0.6 ** (k + 1) * share * _facets(canvas, f"small {k}", 0.6**k * size)
    soft = 0.02 * size * bumps(canvas, "soft", Spectrum(size, 0.4 * size))
    ridge, valley = _folds(canvas, size * height, 0.004)
    fold = np.maximum(ridge, valley)
    foil = rng.chance(0.3)
    hue = rng.natural(METALS) if foil else rng.dye()
    fibre = noise(canvas, "fibre", Spectrum(0.03, 0.006, slope=0.5))
    rubbed = rng.uniform(-0.4, 0.6)
    diffuse = hue[:, None, None] * np.exp(0.04 * fibre + rubbed * fold)
    specular = rng.uniform(0.5, 0.9) if foil else rng.dielectric()
    gloss = rng.uniform(0.15, 0.4) if foil else rng.uniform(0.25, 0.85)
    rough = gloss + rng.uniform(0.0, 0.15) * fold + 0.02 * fibre
    return SurfaceFields(diffuse, specular, rough, size * 0.3 * height + soft, valley)


def _facets(canvas: Canvas, label: str, size: float) -> Raster:
    """(H, W) pyramids over random cells, of random height and sign, in units of `size`."""
    cell = cells(canvas, label, size)
    return cell.border * (2.0 * cell.draw(canvas.stream(label + " rise")) - 1.0)


def _folds(canvas: Canvas, height: Raster, width: float) -> tuple[Raster, Raster]:
    """Masks (0 to 1) of convex and concave creases of a faceted height; `width` in plane units."""
    deviation = width / canvas.texel_size
    smooth = cv2.GaussianBlur(height, (0, 0), deviation, borderType=cv2.BORDER_REFLECT)
    curvature: Raster = np.asarray(cv2.Laplacian(smooth, cv2.CV_64F), np.float64)
    curvature /= canvas.texel_size**2
    scale = 0.4 / width  # a fold of slope 1, blurred
    return smoothstep(0.2, 1.0, -curvature / scale), smoothstep(0.2, 1.0, curvature / scale)
