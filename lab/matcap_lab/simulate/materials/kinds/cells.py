"""Closed cells parted by grooves, and glaze parted by thin cracks."""

from __future__ import annotations

import numpy as np

from matcap_lab.simulate.materials.draws import CLAYS, STONES, Draws
from matcap_lab.simulate.materials.kinds.place import border_distance, warp
from matcap_lab.simulate.materials.kinds.surface_fields import SurfaceFields
from matcap_lab.simulate.procedural import Canvas, Spectrum, cells, mix, noise, pick, smoothstep


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
