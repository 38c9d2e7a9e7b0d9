"""Woven cloth: a regular plain weave of slightly uneven, dyed, twisted threads."""

from __future__ import annotations

import math

import numpy as np

from matcap.brdf.maps import MapSet
from matcap.lab.simulate.materials.assemble import assemble
from matcap.lab.simulate.procedural import Canvas, Spectrum, colour, mix, noise, smoothstep, weave

_SPACING = 13.0 * 2.0 / 1024.0  # plane units a thread: 13 texels at 1024 across


def cloth(canvas: Canvas) -> MapSet:
    """Realise woven cloth."""
    shift = canvas.stream("place").uniform(1.0, 2.0, size=2)
    # The loom is regular; threads wander by a few hundredths of their spacing.
    upright = Spectrum(coarse=0.1, fine=0.03, stretch=6.0, angle=math.pi / 2.0)
    level = Spectrum(coarse=0.1, fine=0.03, stretch=6.0)
    u = canvas.x / _SPACING + shift[0] + 0.06 * noise(canvas, "sway u", upright)
    v = canvas.y / _SPACING + shift[1] + 0.06 * noise(canvas, "sway v", level)
    threads = weave(u, v, fill=0.94, depth=0.28)

    # Fibres: fine lines twisted around the thread.
    twist = threads.along + 0.35 * np.where(threads.warp_on_top, 1, -1) * threads.across
    fuzz = noise(canvas, "fuzz", Spectrum(0.02, 0.0045))
    fibre = np.sin(2 * np.pi * (3.0 * twist) + 1.4 * fuzz)
    bulge = 0.5 * (1.0 - threads.across**2)
    slub = 0.03 * noise(canvas, "slub", Spectrum(0.08, 0.02))
    height = _SPACING * (0.36 * threads.height + slub + 0.022 * bulge * fibre)

    gap = smoothstep(0.0, 0.30, threads.height)
    dye = threads.per_thread(canvas.stream("dye"))
    tone = np.exp(0.16 * dye + 0.10 * fuzz + 0.07 * fibre) * (0.28 + 0.72 * gap)
    warp = colour(0.050, 0.085, 0.165)
    weft = colour(0.105, 0.150, 0.230)
    diffuse = mix(weft, warp, threads.warp_on_top.astype(np.float64)) * tone
    rough = 0.68 + 0.03 * dye + 0.04 * fuzz + 0.12 * (1.0 - gap)
    return assemble(canvas, diffuse, 0.035 + 0.01 * gap, rough, height)
