"""Coats on something else: chipped and worn paint; plaster drawn with a trowel; sand."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap_lab.simulate.materials.draws import METALS, STONES, WOODS, Draws, Integers, value_noise
from matcap_lab.simulate.materials.kinds.place import border_distance, rotated, scatter, splat, warp
from matcap_lab.simulate.materials.kinds.surface_fields import SurfaceFields
from matcap_lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    cells,
    mix,
    noise,
    pick,
    smoothstep,
)


def _ground(canvas: Canvas, rng: Draws) -> tuple[Raster, Raster, Raster, Raster]:
    """Diffuse, F0, roughness and height of the substrate: metal, rust, wood or stone.

    Height is in units of the paint's thickness.
    """
    turn = rng.angle()
    fine = noise(canvas, "ground", Spectrum(0.04, 0.006, slope=0.7))
    grain = noise(canvas, "ground grain", Spectrum(0.05, 0.006, 0.7, stretch=14.0, angle=turn))
    what = rng.integers(4)
    if what == 0:  # bare metal
        rough = rng.uniform(0.2, 0.45) + 0.03 * grain
        diffuse = rng.natural(METALS)[:, None, None] * np.exp(0.2 * grain)
        return diffuse, np.full_like(fine, rng.uniform(0.45, 0.8)), rough, 0.1 * grain
    if what == 1:  # rust
        rust = rng.shade(np.array([0.22, 0.085, 0.03]), 0.4)[:, None, None] * np.exp(0.35 * fine)
        return rust, np.full_like(fine, 0.04), 0.82 + 0.04 * fine, 0.4 * fine
    if what == 2:
        wood = rng.natural(WOODS)[:, None, None] * np.exp(0.25 * grain)
        return wood, np.full_like(fine, 0.04), rng.uniform(0.55, 0.85) + 0.03 * grain, 0.3 * grain
    stone = rng.natural(STONES)[:, None, None] * np.exp(0.1 * fine)
    return stone, np.full_like(fine, 0.038), 0.85 + 0.02 * fine, 0.3 * fine


def chipped(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Paint that has flaked off in places, with a step at the edges, which may be raised."""
    size = rng.log_uniform(0.05, 0.15)
    paint = rng.dye()
    patch = noise(canvas, "patch", Spectrum(size * 1.3, rng.log_uniform(0.008, 0.02), slope=1.5))
    left = rng.uniform(-0.9, 0.3)
    if rng.chance(0.5):  # torn along cracks
        bend = warp(canvas, "cracks", 0.5 * size, 0.06 * size)
        flake = cells(canvas, "cracks", 0.5 * size, warp=bend)
        patch = 0.45 * patch + 1.1 * (2.0 * flake.draw(canvas.stream("gone")) - 1.0)
        crack = smoothstep(0.004, 0.0015, border_distance(canvas, flake)) * rng.uniform(0.0, 1.0)
    else:
        crack = np.zeros_like(patch)
    covered = patch > left
    distance = _distance(canvas, covered)
    coat = np.where(covered, smoothstep(0.0, 1.5 * canvas.texel_size, distance), 0.0) * (
        1.0 - crack
    )
    thick = rng.log_uniform(0.002, 0.006)
    lip = rng.uniform(-0.4, 1.2) * np.exp(-distance / (2.5 * thick))
    diffuse, specular, rough, ground = _ground(canvas, rng)
    primer = rng.shade(paint, 0.6, 0.2)[:, None, None]
    brush = noise(canvas, "brush", Spectrum(0.06, 0.008, 0.8, stretch=8.0, angle=rng.angle()))
    top = paint[:, None, None] * np.exp(rng.uniform(0.0, 0.1) * brush)
    if rng.chance(0.4):  # two coats
        top = np.where(patch > left + rng.uniform(0.2, 0.9), top, primer)
    gloss = rng.uniform(0.12, 0.7)
    height = mix(0.3 * ground, 1.0 + lip + 0.06 * brush + 0.1 * ground, coat)
    return SurfaceFields(
        mix(diffuse, top, coat),
        mix(specular, np.array(rng.uniform(0.04, 0.055)), coat),
        mix(rough, gloss + 0.01 * brush, coat),
        thick * height,
        1.0 - coat,
    )


def worn(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """A coat rubbed off the high places of rough ground."""
    size = rng.log_uniform(0.03, 0.08)
    relief = noise(
        canvas,
        "relief",
        Spectrum(2.0 * size, rng.log_uniform(0.01, 0.03), slope=rng.uniform(1.0, 2.0)),
    )
    if rng.chance(0.5):
        relief = 1.2 - 1.8 * np.abs(relief)
    lines = noise(canvas, "rubbed", Spectrum(0.08, 0.006, 0.7, stretch=10.0, angle=rng.angle()))
    high = relief + rng.uniform(0.05, 0.4) * lines
    limit, soft = rng.uniform(0.1, 1.3), rng.log_uniform(0.08, 0.5)
    bare = smoothstep(limit - soft, limit + soft, high)
    diffuse, specular, rough, ground = _ground(canvas, rng)
    paint = rng.dye()[:, None, None] * np.exp(0.06 * relief)
    gloss = rng.uniform(0.2, 0.8)
    edge = 4.0 * bare * (1.0 - bare)
    paint = paint * np.exp(-rng.uniform(0.0, 0.6) * edge)
    return SurfaceFields(
        mix(paint, diffuse, bare),
        mix(np.array(0.045), specular, bare),
        mix(gloss + 0.0 * relief, rough, bare),
        0.2 * size * (relief - rng.uniform(0.0, 0.4) * bare + 0.05 * ground),
        smoothstep(0.3, -1.5, relief),
    )


def strokes(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Plaster or thick paint applied in strokes with ridges along them."""
    size = rng.log_uniform(0.08, 0.2)
    slender, spread, curved = rng.uniform(0.3, 0.7), rng.uniform(0.3, 2.0), rng.uniform(0.0, 0.6)
    favoured, soft, rim_height = rng.angle(), rng.uniform(0.05, 0.6), rng.uniform(0.0, 0.25)

    x, y, sizes = scatter(canvas, "sweeps", 0.4 * size)
    count = x.size
    reach = size * (0.6 + 0.4 * sizes.random(count))
    own = canvas.stream("own")
    turn, level = favoured + spread * own.standard_normal(count), own.random(count)
    arc = curved * own.standard_normal(count)

    def place(dx: Raster, dy: Raster, which: Integers) -> tuple[Raster, Raster]:
        u, v = rotated(dx, dy, turn[which])
        radius = reach[which]
        u = u / radius
        return u, v / (radius * slender) + arc[which] * u * u

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = place(dx, dy, which)
        inside = np.minimum(0.9 - np.abs(u), 0.85 - np.abs(v))
        ridge = rim_height * np.exp(-(((np.abs(v) - 0.75) / 0.12) ** 2))
        body = (0.4 + 0.5 * level[which] + 0.2 * u) * smoothstep(0.0, soft, inside)
        return np.where(inside > 0.0, body + ridge, -np.inf)

    height, index = splat(canvas, x, y, reach, profile, 0.0)
    index = np.maximum(index, 0)
    u, v = place(canvas.x - x[index], canvas.y - y[index], index)
    fine = rng.uniform(2.5, 6.0)
    bristle = value_noise(canvas, "bristle", fine * v, index)
    bristle = 0.7 * bristle + 0.4 * value_noise(canvas, "hair", 2.3 * fine * v, index)
    sand = noise(canvas, "sand", Spectrum(0.02, 0.006, slope=0.4))
    height = height + rng.uniform(0.05, 0.4) * bristle + rng.uniform(0.0, 0.06) * sand
    hue = rng.natural(STONES) if rng.chance(0.5) else rng.dye()
    tones = rng.shades(hue, 10, rng.choice([0.02, 0.1, 0.3]))
    diffuse = pick(tones, own.random(count)[index]) * np.exp(0.06 * bristle + 0.05 * sand)
    rough = rng.uniform(0.3, 0.9) + 0.03 * bristle + 0.02 * sand
    cavity = smoothstep(0.8, -0.2, height)
    return SurfaceFields(diffuse, rng.dielectric(), rough, 0.12 * size * height, cavity)


def sand(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Grains on ripples: sand, sandpaper, roughcast, cork."""
    size = rng.log_uniform(0.012, 0.035)
    hue = rng.natural(STONES) if rng.chance(0.7) else rng.dye()
    loose = rng.uniform(0.3, 0.9)

    x, y, sizes = scatter(canvas, "grains", 0.75 * size)
    count = x.size
    reach = size * (0.3 + 0.4 * sizes.random(count))
    own = canvas.stream("own")
    level = loose * own.random(count)

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        radius = reach[which]
        body = 1.0 - (dx * dx + dy * dy) / radius**2
        high = radius * np.sqrt(np.maximum(body, 0.0)) + size * level[which]
        return np.where(body > 0.0, high, -np.inf)

    height, index = splat(canvas, x, y, reach, profile, 0.1 * size)
    bare = index < 0
    turn, period = rng.uniform(0.0, math.pi), rng.log_uniform(0.06, 0.16)
    ripple = noise(canvas, "ripple", Spectrum(period, 0.6 * period, 0.5, stretch=3.0, angle=turn))
    height = height + rng.choice([0.0, 0.6]) * size * ripple
    tones = rng.shades(hue, 12, rng.uniform(0.05, 0.5))
    if rng.chance(0.4):
        tones = np.concatenate([tones, rng.shades(rng.natural(STONES), 4, 0.3)])
    diffuse = pick(tones, own.random(count)[index])
    glint = rng.uniform(0.0, 0.2) * own.standard_normal(count)[index]
    rough = rng.uniform(0.4, 0.9) + glint
    cavity = np.maximum(bare, smoothstep(0.9 * size, 0.1 * size, height))
    return SurfaceFields(diffuse, rng.dielectric(), rough, height, cavity)


def _distance(canvas: Canvas, mask: NDArray[np.bool_]) -> Raster:
    """(H, W) unsigned distance to the border of a mask, plane units."""
    inner, outer = (
        cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 5) for part in (mask, ~mask)
    )
    return np.asarray(inner + outer, dtype=np.float64) * canvas.texel_size
