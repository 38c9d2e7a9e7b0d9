"""Rusted metal: bare, scratched patches of steel in a rough crust of brown and orange rust."""

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


def rust(canvas: Canvas) -> MapSet:
    """Realise rusted metal."""
    patches = noise(canvas, "patches", Spectrum(coarse=0.11, fine=0.006, slope=1.7))
    crumbs = noise(canvas, "crumbs", Spectrum(coarse=0.03, fine=0.0045, slope=0.8))
    crust = smoothstep(-0.40, 0.20, patches + 0.2 * crumbs + 0.35)
    stain = smoothstep(-1.0, 0.0, patches + 0.3 * crumbs)
    blisters = cells(canvas, "blisters", 0.03, jitter=1.0)
    raised = np.maximum(0.0, 1.0 - (blisters.nearest / 0.5) ** 2)
    raised = raised * (blisters.draw(canvas.stream("blistered")) < 0.4)

    scratches = noise(
        canvas, "scratches", Spectrum(0.02, 0.004, slope=0.3, stretch=14.0, angle=0.2)
    )
    metal_height = 0.04 * bumps(canvas, "brush", Spectrum(0.02, 0.005, stretch=10.0, angle=0.2))
    rust_height = (
        0.17 * bumps(canvas, "grit", Spectrum(0.012, 0.0045, slope=0.6))
        + 0.14 * bumps(canvas, "scale", Spectrum(0.06, 0.014))
        + 0.0016 * raised
        + 0.0013
    )
    height = mix(metal_height, rust_height, crust)

    age = smoothstep(-1.4, 1.6, noise(canvas, "age", Spectrum(0.09, 0.006)) + 0.8 * patches)
    brown = mix(colour(0.29, 0.115, 0.036), colour(0.105, 0.043, 0.024), age)
    flecks = smoothstep(0.7, 1.8, noise(canvas, "flecks", Spectrum(0.03, 0.006)))
    brown = mix(brown, colour(0.40, 0.165, 0.045), 0.8 * flecks * (1.0 - age))
    brown = brown * np.exp(0.2 * crumbs)
    steel = colour(0.035, 0.034, 0.033) * np.exp(0.1 * scratches)
    steel = mix(steel, colour(0.085, 0.043, 0.02), 0.7 * stain)
    diffuse = mix(steel, brown, crust)
    specular = mix(0.56 + 0.02 * scratches - 0.22 * stain, 0.042 + 0.0 * crust, crust)
    steel_rough = 0.40 + 0.03 * scratches + 0.16 * stain
    rough = mix(steel_rough, 0.86 + 0.03 * crumbs, crust)
    return assemble(canvas, diffuse, specular, rough, height)
