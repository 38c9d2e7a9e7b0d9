"""Grained leather: domed pebbles parted by creases, pores, a dyed and lightly varnished skin."""

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

_GRAIN = 0.042  # plane units a pebble
_PORE = 0.021


def leather(canvas: Canvas) -> MapSet:
    """Realise leather."""
    bend = Spectrum(coarse=0.12, fine=0.04)
    warp = (0.0045 * noise(canvas, "bend x", bend), 0.0045 * noise(canvas, "bend y", bend))
    pebbles = cells(canvas, "pebbles", _GRAIN, jitter=0.85, stretch=1.25, angle=0.5, warp=warp)
    folds = cells(canvas, "folds", 0.45 * _GRAIN, warp=warp)
    pores = cells(canvas, "pores", _PORE, jitter=0.9)

    # The width of creases varies, so that pebbles run together here and there.
    width = 0.26 * np.exp(0.3 * noise(canvas, "width", Spectrum(0.15, 0.05)))
    depth = smoothstep(-1.6, 0.6, noise(canvas, "depth", Spectrum(0.12, 0.045)))
    crease = np.exp(-((pebbles.border / width) ** 2)) * (0.25 + 0.75 * depth)
    fold = np.exp(-((folds.border / 0.25) ** 2))
    pore = np.exp(-((pores.nearest / 0.13) ** 2)) * (pores.draw(canvas.stream("pored")) < 0.35)
    dome = 1.0 - pebbles.nearest**2

    tall = 0.03 * pebbles.draw(canvas.stream("tall"))
    height = _GRAIN * ((0.035 * dome + tall) * (1.0 - crease) - 0.05 * crease - 0.006 * fold)
    height = height - 0.0007 * pore + 0.045 * bumps(canvas, "skin", Spectrum(0.012, 0.005))
    height = height + 0.02 * bumps(canvas, "hide", Spectrum(0.15, 0.06))

    tone = np.exp(
        0.07 * noise(canvas, "dye", Spectrum(0.14, 0.01)) - 0.55 * crease - 0.5 * pore - 0.1 * fold
    )
    hue = smoothstep(-2.0, 2.0, noise(canvas, "hue", Spectrum(0.14, 0.02)))
    diffuse = mix(colour(0.175, 0.062, 0.026), colour(0.215, 0.085, 0.036), hue) * tone
    rough = 0.40 + 0.22 * crease + 0.1 * pore + 0.025 * noise(canvas, "wear", Spectrum(0.14, 0.01))
    specular = 0.046 - 0.012 * crease
    return assemble(canvas, diffuse, specular, rough, height)
