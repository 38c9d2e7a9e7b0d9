"""Polished granite: interlocking crystals of feldspar, quartz and mica."""

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
    pick,
    smoothstep,
)

_CRYSTAL = 0.034

# Pink and white feldspar, grey quartz; a crystal picks one.
_PALETTE = np.array(
    [
        [0.44, 0.24, 0.18],
        [0.50, 0.30, 0.23],
        [0.38, 0.21, 0.165],
        [0.56, 0.50, 0.44],
        [0.62, 0.56, 0.50],
        [0.27, 0.255, 0.245],
        [0.21, 0.20, 0.20],
        [0.33, 0.31, 0.29],
    ]
)


def granite(canvas: Canvas) -> MapSet:
    """Realise granite."""
    bend = Spectrum(coarse=0.05, fine=0.008)
    warp = (0.0045 * noise(canvas, "bend x", bend), 0.0045 * noise(canvas, "bend y", bend))
    crystals = cells(canvas, "crystals", _CRYSTAL, warp=warp)
    grains = cells(canvas, "grains", 0.45 * _CRYSTAL, warp=warp)
    flakes = cells(canvas, "flakes", 0.52 * _CRYSTAL, warp=warp)

    body = pick(_PALETTE, crystals.draw(canvas.stream("mineral")))
    small = pick(_PALETTE, grains.draw(canvas.stream("small mineral")))
    crumbled = (crystals.draw(canvas.stream("crumbled")) < 0.35).astype(np.float64)
    diffuse = mix(body, small, crumbled)
    shade = crystals.draw(canvas.stream("shade")) - 0.5
    streaks = noise(canvas, "streaks", Spectrum(0.02, 0.005, stretch=2.0, angle=0.9))
    cloud = noise(canvas, "cloud", Spectrum(0.03, 0.004, slope=0.8))
    diffuse = diffuse * np.exp(0.35 * shade + 0.10 * cloud + 0.05 * streaks)

    # Mica gathers in clumps of black flakes.
    clump = 0.3 * noise(canvas, "clump", Spectrum(0.12, 0.04))
    mica = (flakes.draw(canvas.stream("mica")) + clump < 0.19) * smoothstep(0.0, 0.1, flakes.border)
    diffuse = mix(diffuse, colour(0.014, 0.014, 0.016) * np.exp(0.3 * cloud), mica)
    seam = np.exp(-((grains.border / 0.07) ** 2)) * crumbled
    diffuse = diffuse * (1.0 - 0.25 * seam)

    pits = smoothstep(2.1, 2.9, noise(canvas, "pits", Spectrum(0.02, 0.006)))
    height = 0.020 * bumps(canvas, "polish", Spectrum(0.06, 0.008)) - 0.0007 * pits
    height = height - 0.00022 * mica - 0.00012 * seam
    rough = 0.20 + 0.10 * mica + 0.25 * pits + 0.03 * shade
    specular = 0.043 + 0.014 * mica - 0.01 * pits
    return assemble(canvas, diffuse * (1.0 - 0.5 * pits), specular, rough, height)
