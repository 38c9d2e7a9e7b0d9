"""Bare metals: hammered and brushed."""

from __future__ import annotations

import numpy as np

from matcap.lab.simulate.materials.kinds.draws import (
    METALS,
    Whole,
    angle,
    chance,
    log_uniform,
    natural,
)
from matcap.lab.simulate.materials.kinds.place import scatter, splat
from matcap.lab.simulate.materials.kinds.surface_fields import SurfaceFields
from matcap.lab.simulate.procedural import Canvas, Raster, Spectrum, noise, smoothstep


def hammered(canvas: Canvas, rng: np.random.Generator) -> SurfaceFields:
    """Dimples that overlap, each the print of a hammer's round face."""
    size = log_uniform(rng, 0.035, 0.16)
    spread, raised = rng.uniform(0.02, 0.25), chance(rng, 0.2)

    def reach(generator: np.random.Generator, count: int) -> Raster:
        return 0.95 * size * np.exp(spread * np.clip(generator.standard_normal(count), -2.5, 0.0))

    marks = scatter(canvas, "marks", 0.8 * size, reach)
    blow = spread * size * canvas.stream("blow").standard_normal(marks.count)

    def profile(dx: Raster, dy: Raster, which: Whole) -> Raster:
        radius = marks.reach[which]
        depth = (radius**2 - dx * dx - dy * dy) / size
        return np.where(depth > 0.0, depth + 0.3 * blow[which], -np.inf)

    deep, index = splat(canvas, marks, profile)
    deep = np.where(index >= 0, deep, 0.0) / size
    height = deep if raised else -deep
    top = smoothstep(0.55, 0.05, deep) if not raised else smoothstep(0.1, 0.6, deep)
    tarnish = noise(canvas, "tarnish", Spectrum(0.15, 0.015, slope=1.3))
    brush = noise(canvas, "brush", Spectrum(0.03, 0.006, 0.5, stretch=6.0, angle=angle(rng)))
    old = rng.uniform(0.0, 0.06)
    specular = rng.uniform(0.5, 0.9) * np.exp(-2.0 * old * smoothstep(-1.0, 2.0, tarnish))
    rough = log_uniform(rng, 0.12, 0.42) + old * tarnish + 0.015 * brush
    diffuse = natural(rng, METALS)[:, None, None] * np.exp(0.3 * tarnish + 0.05 * brush)
    height = size * height + 0.0002 * brush
    return SurfaceFields(diffuse, specular, rough, height, 1.0 - top)


def brushed(canvas: Canvas, rng: np.random.Generator) -> SurfaceFields:
    """Long fine streaks in one direction, or two, in slope, gloss and brightness."""
    turn = angle(rng)
    long = log_uniform(rng, 25.0, 90.0)
    fine = log_uniform(rng, 0.004, 0.009)
    crossed = chance(rng, 0.2)

    def lines(label: str, turn: float) -> Raster:
        thin = noise(canvas, label, Spectrum(4.0 * fine, fine, 0.4, stretch=long, angle=turn))
        wide = Spectrum(0.1, 2.0 * fine, 0.8, stretch=long, angle=turn)
        return thin + 0.6 * noise(canvas, label + " wide", wide)

    streak = lines("streak", turn)
    if crossed:
        streak = np.where(
            noise(canvas, "patch", Spectrum(0.16, 0.06)) > 0.0, streak, lines("other", turn + 1.2)
        )
    scratch = smoothstep(1.8, 2.6, streak)
    tarnish = noise(canvas, "tarnish", Spectrum(0.16, 0.03, slope=1.5))
    shine = rng.uniform(0.5, 0.92)
    specular = np.clip(shine * np.exp(0.05 * streak - 0.05 * rng.random() * tarnish), 0.4, 0.95)
    rough = rng.uniform(0.18, 0.5) + rng.uniform(0.01, 0.07) * streak + 0.02 * tarnish
    diffuse = natural(rng, METALS)[:, None, None] * np.exp(0.2 * streak + 0.1 * tarnish)
    height = fine * (streak + scratch)
    return SurfaceFields(
        diffuse, specular, rough + 0.1 * scratch, height, smoothstep(0.5, -2.0, streak)
    )
