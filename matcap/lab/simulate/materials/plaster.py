"""Plaster: a rough, warm white wall with fine bumps, trowel marks and small pinholes."""

from __future__ import annotations

import numpy as np

from matcap.brdf.maps import MapSet
from matcap.lab.simulate.materials.assemble import assemble
from matcap.lab.simulate.procedural import (
    Canvas,
    Spectrum,
    bumps,
    cells,
    colour,
    mix,
    noise,
    smoothstep,
)


def plaster(canvas: Canvas) -> MapSet:
    """Realise plaster."""
    lumps = bumps(canvas, "lumps", Spectrum(coarse=0.10, fine=0.02, slope=1.4))
    sand = bumps(canvas, "sand", Spectrum(coarse=0.02, fine=0.005, slope=0.6))
    drag = bumps(canvas, "drag", Spectrum(0.05, 0.009, slope=1.2, stretch=4.0, angle=-0.5))
    holes = cells(canvas, "holes", 0.03)
    hole = np.exp(-((holes.nearest / (0.05 + 0.1 * holes.draw(canvas.stream("wide")))) ** 2))
    hole = hole * (holes.draw(canvas.stream("holed")) < 0.3)
    grains = cells(canvas, "grains", 0.013)
    grain = np.maximum(0.0, 1.0 - (grains.nearest / 0.42) ** 2)
    grain = grain * (grains.draw(canvas.stream("grained")) < 0.4)

    height = 0.18 * lumps + 0.13 * sand + 0.12 * drag - 0.0022 * hole + 0.0007 * grain
    stain = noise(canvas, "stain", Spectrum(0.12, 0.01, slope=1.2))
    base = mix(colour(0.56, 0.50, 0.41), colour(0.66, 0.62, 0.54), smoothstep(-2, 2, stain))
    dust = noise(canvas, "dust", Spectrum(0.02, 0.0045, slope=0.5))
    dirt = smoothstep(0.0, -1.0, lumps / 0.012)
    tone = np.exp(0.035 * dust - 0.9 * hole - 0.10 * dirt + 0.03 * grain)
    rough = 0.82 + 0.02 * dust + 0.02 * stain
    return assemble(canvas, base * tone, 0.038, rough, height)
