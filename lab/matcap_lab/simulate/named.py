"""The named materials, which example photographs show: realise(name, ...)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap_lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    assemble,
    bumps,
    cells,
    colour,
    displacement,
    mix,
    noise,
    pick,
    smoothstep,
    weave,
)
from matcap_lab.simulate.varied import RandomMaterial, random_material

_PEBBLE = 0.042  # plane units a pebble
_PORE = 0.021


def leather(canvas: Canvas) -> MapSet:
    """Grained leather: domed pebbles parted by creases, pores, a dyed, varnished skin."""
    warp = displacement(canvas, "bend", Spectrum(coarse=0.12, fine=0.04), 0.0045)
    pebbles = cells(canvas, "pebbles", _PEBBLE, jitter=0.85, stretch=1.25, angle=0.5, warp=warp)
    folds = cells(canvas, "folds", 0.45 * _PEBBLE, warp=warp)
    pores = cells(canvas, "pores", _PORE, jitter=0.9)

    # The width of creases varies, so that pebbles run together here and there.
    width = 0.26 * np.exp(0.3 * noise(canvas, "width", Spectrum(0.15, 0.05)))
    depth = smoothstep(-1.6, 0.6, noise(canvas, "depth", Spectrum(0.12, 0.045)))
    crease = np.exp(-((pebbles.border / width) ** 2)) * (0.25 + 0.75 * depth)
    fold = np.exp(-((folds.border / 0.25) ** 2))
    pore = np.exp(-((pores.nearest / 0.13) ** 2)) * (pores.draw(canvas.stream("pored")) < 0.35)
    dome = 1.0 - pebbles.nearest**2

    tall = 0.03 * pebbles.draw(canvas.stream("tall"))
    height = _PEBBLE * ((0.035 * dome + tall) * (1.0 - crease) - 0.05 * crease - 0.006 * fold)
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


_CLOTH_SPACING = 13.0 * 2.0 / 1024.0  # plane units a thread: 13 texels at 1024 across


def cloth(canvas: Canvas) -> MapSet:
    """Woven cloth: a regular plain weave of slightly uneven, dyed, twisted threads."""
    shift = canvas.stream("place").uniform(1.0, 2.0, size=2)
    # The loom is regular; threads wander by a few hundredths of their spacing.
    upright = Spectrum(coarse=0.1, fine=0.03, stretch=6.0, angle=math.pi / 2.0)
    level = Spectrum(coarse=0.1, fine=0.03, stretch=6.0)
    u = canvas.x / _CLOTH_SPACING + shift[0] + 0.06 * noise(canvas, "sway u", upright)
    v = canvas.y / _CLOTH_SPACING + shift[1] + 0.06 * noise(canvas, "sway v", level)
    threads = weave(u, v, fill=0.94, depth=0.28)

    # Fibres: fine lines twisted around the thread.
    twist = threads.along + 0.35 * np.where(threads.warp_on_top, 1, -1) * threads.across
    fuzz = noise(canvas, "fuzz", Spectrum(0.02, 0.0045))
    fibre = np.sin(2 * np.pi * (3.0 * twist) + 1.4 * fuzz)
    bulge = 0.5 * (1.0 - threads.across**2)
    slub = 0.03 * noise(canvas, "slub", Spectrum(0.08, 0.02))
    height = _CLOTH_SPACING * (0.36 * threads.height + slub + 0.022 * bulge * fibre)

    gap = smoothstep(0.0, 0.30, threads.height)
    dye = threads.per_thread(canvas.stream("dye"))
    tone = np.exp(0.16 * dye + 0.10 * fuzz + 0.07 * fibre) * (0.28 + 0.72 * gap)
    warp = colour(0.050, 0.085, 0.165)
    weft = colour(0.105, 0.150, 0.230)
    diffuse = mix(weft, warp, threads.warp_on_top.astype(np.float64)) * tone
    rough = 0.68 + 0.03 * dye + 0.04 * fuzz + 0.12 * (1.0 - gap)
    return assemble(canvas, diffuse, 0.035 + 0.01 * gap, rough, height)


_GRANITE_CRYSTAL = 0.034

# Pink and white feldspar, grey quartz; a crystal picks one.
_GRANITE_PALETTE = np.array(
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
    """Polished granite: interlocking crystals of feldspar, quartz and mica."""
    warp = displacement(canvas, "bend", Spectrum(coarse=0.05, fine=0.008), 0.0045)
    crystals = cells(canvas, "crystals", _GRANITE_CRYSTAL, warp=warp)
    grains = cells(canvas, "grains", 0.45 * _GRANITE_CRYSTAL, warp=warp)
    flakes = cells(canvas, "flakes", 0.52 * _GRANITE_CRYSTAL, warp=warp)

    body = pick(_GRANITE_PALETTE, crystals.draw(canvas.stream("mineral")))
    small = pick(_GRANITE_PALETTE, grains.draw(canvas.stream("small mineral")))
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


def rust(canvas: Canvas) -> MapSet:
    """Rusted metal: bare, scratched patches of steel in a rough crust of brown and orange rust."""
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


def plaster(canvas: Canvas) -> MapSet:
    """Plaster: a rough, warm white wall with fine bumps, trowel marks and small pinholes."""
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


_SIDE = 2.0 / 24.0  # plane units a tile: 24 across the picture
_GROUT = 0.075  # half the joint, as share of the tile
_TILE_PALETTE = np.array(
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
    """Glazed mosaic: small glossy, pillowed tiles of varied colour in rough, lower grout."""
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

    glaze = pick(_TILE_PALETTE, 0.5 + 0.4999 * draw("colour"))
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


# Procedural stationary materials: the same parameters, another realisation for every seed.

__all__ = ["MATERIALS", "RandomMaterial", "random_material", "realise"]

MATERIALS: Mapping[str, Callable[[Canvas], MapSet]] = MappingProxyType(
    {
        "leather": leather,
        "cloth": cloth,
        "granite": granite,
        "rust": rust,
        "plaster": plaster,
        "tile": tile,
    }
)


def realise(name: str, width: int, height: int, seed: int, texel_size: float) -> MapSet:
    """One realisation of a material of MATERIALS, float64 (C, height, width).

    A seed, not negative, is a realisation; a finer texel size (plane units) over the same extent
    shows the same one in more detail.

    Raises:
        UsageError: no material of that name.
    """
    if name not in MATERIALS:
        raise UsageError.at(
            name, "there is no such material", f"choose from {', '.join(MATERIALS)}"
        )
    return MATERIALS[name](Canvas(width, height, texel_size, seed))
