"""Sheets: felt, paper, creased foil or cloth."""

from __future__ import annotations

import numpy as np

from matcap.lab.simulate.fields import Canvas, Field, Spectrum, bumps, noise, smoothstep
from matcap.lab.simulate.materials.kinds.draws import (
    METALS,
    Whole,
    chance,
    dielectric,
    dye,
    log_uniform,
    natural,
    palette_of,
    piece,
    shade,
    shades,
)
from matcap.lab.simulate.materials.kinds.place import paths, splat, spun, turned, warp
from matcap.lab.simulate.materials.kinds.surface import Surface


def felt(canvas: Canvas, rng: np.random.Generator) -> Surface:
    """Wavy fibres over one another: felt, fleece, coir."""
    width = log_uniform(rng, 0.006, 0.014)
    pieces, step = 10, width * rng.uniform(1.5, 3.0)
    curl, loose, favoured = (
        rng.uniform(0.1, 0.5),
        rng.choice([0.3, 3.0, 3.0]),
        rng.uniform(0, np.pi),
    )

    def direction(generator: np.random.Generator, count: int) -> Field:
        return favoured + loose * generator.standard_normal(count)

    pitch = np.sqrt(width * pieces * step) * rng.uniform(0.55, 0.95)
    fibres, turn, whose = paths(canvas, "fibres", pitch, pieces, step, curl, direction, width)
    own = canvas.stream("own")
    count = int(whose.max()) + 1
    level, slant = own.random(count), own.standard_normal(count)
    thick = width * (0.6 + 0.8 * own.random(count))
    order = np.arange(fibres.count) % pieces / (pieces - 1.0) - 0.5

    def profile(dx: Field, dy: Field, which: Whole) -> Field:
        u, v = spun(dx, dy, turn[which])
        chain = whose[which]
        far = np.hypot(np.maximum(np.abs(u) - 0.5 * step, 0.0), v) / thick[chain]
        place = order[which] + u / (pieces * step)
        high = width * (2.5 * level[chain] + 1.5 * slant[chain] * place)
        high = high + thick[chain] * np.sqrt(np.maximum(1.0 - far**2, 0.0))
        return np.where(far < 1.0, high, -np.inf)

    height, index = splat(canvas, fibres, profile)
    fibre = whose[index]
    floor = -1.0 * width
    height = np.where(index >= 0, height, floor)
    tones = shades(rng, dye(rng), 9, rng.choice([0.05, 0.2, 0.5]))
    if chance(rng, 0.2):
        tones = np.concatenate([tones, shades(rng, dye(rng), 5, 0.2)])
    diffuse = palette_of(tones, own.random(count)[fibre])
    rough = rng.uniform(0.5, 0.92) + 0.03 * own.standard_normal(count)[fibre]
    cavity = smoothstep(3.0 * width, -1.0 * width, height)
    return Surface(diffuse, dielectric(rng), rough, height, cavity)


def paper(canvas: Canvas, rng: np.random.Generator) -> Surface:
    """Flat stock with flecks and cloudy formation: paper, card, vinyl."""
    stock = np.clip(dye(rng) if chance(rng, 0.5) else shade(rng, np.full(3, 0.7), 0.15), 0.02, 0.88)
    cloud = noise(canvas, "cloud", Spectrum(0.05, 0.015, slope=0.8))
    length = log_uniform(rng, 4.0, 10.0)
    flock = np.full((canvas.height, canvas.width), -4.0)
    start = rng.uniform(0.0, np.pi)
    for k in range(5):
        spectrum = Spectrum(0.02, 0.005, 0.2, stretch=length, angle=start + k * np.pi / 5)
        flock = np.maximum(flock, noise(canvas, f"flock {k}", spectrum))
    fleck = smoothstep(2.2, 2.8, noise(canvas, "fleck", Spectrum(0.02, 0.006, slope=0.0)))
    ink = shade(rng, stock, 1.0, 0.4)[:, None, None]
    share = rng.choice([0.0, 0.8]) * fleck
    diffuse = stock[:, None, None] * np.exp(rng.uniform(0.01, 0.08) * (cloud + flock))
    diffuse = diffuse + share * (ink - diffuse)
    rough = rng.choice([rng.uniform(0.15, 0.4), rng.uniform(0.5, 0.9)]) + 0.015 * flock
    height = 0.3 * cloud * rng.random() + rng.uniform(0.2, 1.0) * flock
    if chance(rng, 0.3):  # laid or embossed
        _, across = turned(canvas, "laid", rng.uniform(0.0, np.pi), 0.5, 0.0)
        height = height + 1.2 * np.sin(2.0 * np.pi * across / log_uniform(rng, 0.015, 0.05))
    cavity = smoothstep(0.0, -2.0, height)
    return Surface(diffuse, dielectric(rng), rough, 0.002 * height, cavity)


def creased(canvas: Canvas, rng: np.random.Generator) -> Surface:
    """A sheet crumpled into facets and smoothed again: paper, foil, cloth."""
    size = log_uniform(rng, 0.06, 0.16)
    height = _facets(canvas, "large", size, 0.3)
    height = height + rng.uniform(0.2, 0.6) * _facets(canvas, "small", 0.45 * size, 0.25)
    soft = 0.02 * size * bumps(canvas, "soft", Spectrum(size, 0.4 * size))
    crest = _bend(canvas, height) * canvas.texel_size
    fold = smoothstep(0.4, 1.6, crest / (np.abs(crest).mean() * 2.0 + 1e-12))
    foil = chance(rng, 0.3)
    hue = natural(rng, METALS) if foil else dye(rng)
    fibre = noise(canvas, "fibre", Spectrum(0.03, 0.006, slope=0.5))
    rubbed = rng.uniform(-0.4, 0.6)
    diffuse = hue[:, None, None] * np.exp(0.04 * fibre + rubbed * fold)
    specular = rng.uniform(0.5, 0.9) if foil else dielectric(rng)
    rough = rng.uniform(0.15, 0.4) if foil else rng.uniform(0.25, 0.85)
    rough = rough + rng.uniform(0.0, 0.15) * fold + 0.02 * fibre
    low = smoothstep(0.0, -1.5, (height - height.mean()) / height.std())
    return Surface(diffuse, specular, rough, size * 0.3 * height + soft, 0.7 * low)


def _facets(canvas: Canvas, label: str, size: float, reach: float) -> Field:
    """Random heights at the corners of bent triangles, plane in between."""
    bend_x, bend_y = warp(canvas, label, size, reach * size)
    along, across = turned(canvas, label, 0.4, size, 0.0)
    u, v = (along + bend_x) / size, (across + bend_y) / size
    skewed = u + 0.5 * v
    i, j = np.floor(skewed).astype(np.int64), np.floor(v).astype(np.int64)
    s, t = skewed - i, v - j

    def corner(right: int, down: int) -> Field:
        return 2.0 * piece(canvas, label + " corner", i + right, j + down) - 1.0

    upper = s + t < 1.0
    first = np.where(upper, corner(0, 0), corner(1, 1))
    second, third = corner(1, 0), corner(0, 1)
    a, b = np.where(upper, s, 1.0 - t), np.where(upper, t, 1.0 - s)
    return first + (second - first) * a + (third - first) * b


def _bend(canvas: Canvas, height: Field) -> Field:
    """How sharply a height is folded."""
    down, right = np.gradient(height, canvas.texel_size)
    return np.abs(np.gradient(right, axis=1)) + np.abs(np.gradient(down, axis=0))
