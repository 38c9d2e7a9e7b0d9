"""Wood: planks with grain and pores, scratched varnish, boards of pressed flakes."""

from __future__ import annotations

import numpy as np

from matcap_lab.simulate.materials.draws import WOODS, Draws, Integers, cell_noise, value_noise
from matcap_lab.simulate.materials.kinds.place import (
    frame,
    paths,
    polygons,
    rotated,
    scatter,
    splat,
)
from matcap_lab.simulate.materials.kinds.surface_fields import SurfaceFields
from matcap_lab.simulate.procedural import Canvas, Raster, Spectrum, mix, noise, pick, smoothstep


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
