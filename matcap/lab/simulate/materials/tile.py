"""Glazed mosaic: small glossy, pillowed tiles of varied colour in rough, lower grout."""

from __future__ import annotations

import numpy as np

from matcap.brdf.maps import MapSet
from matcap.lab.simulate.materials.assemble import assemble
from matcap.lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    bumps,
    colour,
    mix,
    noise,
    pick,
    smoothstep,
)

_SIDE = 2.0 / 24.0  # plane units a tile: 24 across the picture
_GROUT = 0.075  # half the joint, as share of the tile
_PALETTE = np.array(
    [
        [0.025, 0.165, 0.195],
        [0.035, 0.215, 0.235],
        [0.018, 0.105, 0.150],
        [0.060, 0.270, 0.260],
        [0.030, 0.145, 0.210],
        [0.280, 0.400, 0.360],
    ]
)


def tile(canvas: Canvas) -> MapSet:
    """Realise glazed tile."""
    shift = canvas.stream("place").uniform(1.0, 2.0, size=2)
    edge = Spectrum(coarse=0.12, fine=0.03)
    u = canvas.x / _SIDE + shift[0] + 0.008 * noise(canvas, "edge u", edge)
    v = canvas.y / _SIDE + shift[1] + 0.008 * noise(canvas, "edge v", edge)
    column, row = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    across, down = 2.0 * (u - column) - 1.0, 2.0 * (v - row) - 1.0
    columns = column.max() + 1
    each = row * columns + column

    def draw(label: str) -> Raster:
        return canvas.stream(label).uniform(-1.0, 1.0, size=int(each.max()) + 1)[each]

    # Distance inside a rounded square, 0 on the tile's border.
    corner = 0.14
    side = 1.0 - _GROUT
    over_u = np.maximum(np.abs(across) - (side - corner), 0.0)
    over_v = np.maximum(np.abs(down) - (side - corner), 0.0)
    inner = np.minimum(np.maximum(np.abs(across), np.abs(down)) - (side - corner), 0.0)
    inside = corner - np.hypot(over_u, over_v) - inner
    glazed = smoothstep(-0.01, 0.035, inside)

    pillow = 1.0 - np.exp(-np.maximum(inside, 0.0) / 0.09)
    slant = 0.02 * (draw("slant u") * across + draw("slant v") * down)
    crown = -0.012 * (across**2 + down**2)
    ripple = 0.022 * bumps(canvas, "ripple", Spectrum(0.05, 0.02))
    grit = 0.16 * bumps(canvas, "grit", Spectrum(0.012, 0.0045, slope=0.6))
    tile_height = _SIDE * 0.5 * (0.075 * pillow + slant + crown + 0.02 * draw("level")) + ripple
    height = mix(grit - 0.0016, tile_height, glazed)

    glaze = pick(_PALETTE, 0.5 + 0.4999 * draw("colour"))
    mottle = noise(canvas, "mottle", Spectrum(0.03, 0.006, slope=1.2))
    # Glaze runs thin on the rim and lets the lighter body through.
    rim = np.exp(-np.maximum(inside, 0.0) / 0.07)
    glaze = glaze * np.exp(0.16 * draw("fired") + 0.12 * mottle)
    glaze = mix(glaze, colour(0.34, 0.33, 0.29), 0.35 * rim)
    speck = smoothstep(2.0, 2.5, noise(canvas, "specks", Spectrum(0.012, 0.005, slope=0.0)))
    glaze = glaze * (1.0 - 0.7 * speck)
    sand = noise(canvas, "sand", Spectrum(0.02, 0.0045, slope=0.4))
    grout = colour(0.37, 0.35, 0.315) * np.exp(0.12 * sand - 0.25 * rim)
    diffuse = mix(grout, glaze, glazed)
    rough = mix(0.84 + 0.02 * sand, 0.17 + 0.025 * draw("gloss") + 0.01 * mottle, glazed)
    specular = mix(0.037 + 0.0 * sand, 0.052 + 0.004 * draw("glass"), glazed)
    return assemble(canvas, diffuse, specular, rough, height)
