"""Bare metals: hammered, brushed, with coloured F0; and coats: paint, plaster, sand.

The latter are plain sheets, anodised, streaked, beaten, rusted, leafed; COLOURED_METALS in this
folder's `__init__`. `random_kind`, which training draws from, leaves them out, so that its stream
is unchanged.
"""

from __future__ import annotations

import colorsys
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.brdf import cook_torrance as metals
from matcap_lab.simulate.kinds.surface import (
    SurfaceFields,
    SurfaceFunction,
    border_distance,
    rotated,
    scatter,
    splat,
    warp,
)
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
from matcap_lab.simulate.varied import METALS, STONES, WOODS, Colours, Draws, Integers, value_noise


def hammered(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Dimples that overlap, each the print of a hammer's round face."""
    size = rng.log_uniform(0.035, 0.16)
    spread, raised = rng.uniform(0.02, 0.25), rng.chance(0.2)

    x, y, sizes = scatter(canvas, "marks", 0.8 * size)
    reach = 0.95 * size * np.exp(spread * np.clip(sizes.standard_normal(x.size), -2.5, 0.0))
    blow = spread * size * canvas.stream("blow").standard_normal(x.size)

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        radius = reach[which]
        depth = (radius**2 - dx * dx - dy * dy) / size
        return np.where(depth > 0.0, depth + 0.3 * blow[which], -np.inf)

    deep, _ = splat(canvas, x, y, reach, profile, 0.0)
    deep = deep / size
    height = deep if raised else -deep
    top = smoothstep(0.55, 0.05, deep) if not raised else smoothstep(0.1, 0.6, deep)
    tarnish = noise(canvas, "tarnish", Spectrum(0.15, 0.015, slope=1.3))
    brush = noise(canvas, "brush", Spectrum(0.03, 0.006, 0.5, stretch=6.0, angle=rng.angle()))
    old = rng.uniform(0.0, 0.06)
    specular = rng.uniform(0.5, 0.9) * np.exp(-2.0 * old * smoothstep(-1.0, 2.0, tarnish))
    rough = rng.log_uniform(0.12, 0.42) + old * tarnish + 0.015 * brush
    diffuse = rng.natural(METALS)[:, None, None] * np.exp(0.3 * tarnish + 0.05 * brush)
    height = size * height + 0.0002 * brush
    return SurfaceFields(diffuse, specular, rough, height, 1.0 - top)


def brushed(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Long fine streaks in one direction, or two, in slope, gloss and brightness."""
    turn = rng.angle()
    long = rng.log_uniform(25.0, 90.0)
    fine = rng.log_uniform(0.004, 0.009)
    crossed = rng.chance(0.2)

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
    diffuse = rng.natural(METALS)[:, None, None] * np.exp(0.2 * streak + 0.1 * tarnish)
    height = fine * (streak + scratch)
    return SurfaceFields(
        diffuse, specular, rough + 0.1 * scratch, height, smoothstep(0.5, -2.0, streak)
    )


METAL_F0: Mapping[str, Colours] = MappingProxyType(
    {name: np.array(f0) for name, f0 in metals.METAL_F0.items()}
)
_OXIDE = 0.04  # F0 of the clear oxide over anodised aluminium, which dye does not reach
_ANODISED = 0.25  # share of drawn metals that are
_RUST = np.array([0.22, 0.085, 0.03])
_BOLE = np.array([0.24, 0.055, 0.032])  # red clay that leaf is laid on


def metal_colour(rng: Draws) -> Colours:
    """(3,) F0, linear Rec.709, of a random metal: mostly a known one, at times anodised.

    Tabulated F0 with random brightness and warmth. Used by this file's kinds and by training.
    """
    if rng.chance(_ANODISED):
        return anodised_f0(rng)
    known = list(METAL_F0.values())
    clean = known[rng.integers(len(known))]
    warmth = 0.04 * rng.standard_normal() * np.array([1.0, 0.1, -1.1])
    return np.asarray(np.clip(clean * np.exp(warmth - rng.uniform(0.0, 0.2)), 0.05, 1.0))


def anodised_f0(rng: Draws) -> Colours:
    """(3,) F0 of dyed aluminium: blue or red more often than any other hue, always saturated.

    F0 = R + (1 - R)^2 F_Al t, R the achromatic reflectance of the oxide's surface, F_Al aluminium's
    F0 and t the dye's transmittance.
    """
    hue = float(rng.choice([0.0, 0.61])) + 0.03 * rng.standard_normal()
    if rng.chance(0.3):
        hue = rng.random()
    dye = np.array(colorsys.hsv_to_rgb(hue % 1.0, rng.uniform(0.7, 0.95), rng.uniform(0.35, 0.9)))
    return np.asarray(_OXIDE + (1.0 - _OXIDE) ** 2 * METAL_F0["aluminium"] * dye)


def _sheet(name: str, canvas: Canvas, rng: Draws) -> SurfaceFields:
    """One metal, from polished to satin, with a fine grain or streaks, and hardly tarnished."""
    fine = rng.log_uniform(0.006, 0.012)
    long = 1.0 if rng.chance(0.5) else rng.log_uniform(8.0, 40.0)
    mark = noise(canvas, "marks", Spectrum(5.0 * fine, fine, 0.5, stretch=long, angle=rng.angle()))
    haze = noise(canvas, "haze", Spectrum(0.15, 0.02, slope=1.5))
    old = rng.uniform(0.0, 0.05)
    specular = METAL_F0[name][:, None, None] * np.exp(-old * smoothstep(-1.0, 2.0, haze))
    rough = rng.log_uniform(0.12, 0.4) * np.exp(0.08 * haze + 0.05 * mark)
    return SurfaceFields(
        _dirt(rng, haze), specular, rough, fine * mark, smoothstep(0.5, -2.0, mark)
    )


def _dirt(rng: Draws, where: Raster) -> Raster:
    """Low diffuse albedo of a clean metal."""
    grey = rng.shade(np.array([0.004, 0.0037, 0.0033]) + 0.01, 0.2) - 0.01
    return np.clip(grey, 0.0, None)[:, None, None] * np.exp(0.4 * where)


def anodised(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Dyed oxide over brushed aluminium, with clear scratches here and there."""
    colour = anodised_f0(rng)[:, None, None]
    under = brushed(canvas, rng)
    streak = under.height / max(float(np.std(under.height)), 1e-9)
    scratch = smoothstep(2.2, 2.8, streak)
    bare = mix(colour, METAL_F0["aluminium"][:, None, None], 0.7 * scratch)
    tone = np.exp(0.04 * streak)
    rough = np.asarray(under.roughness) * rng.uniform(0.7, 1.1) + 0.05
    return SurfaceFields(
        0.03 * colour + 0.0 * streak, bare * tone, rough, under.height, under.cavity
    )


def tinted(grey_metal: SurfaceFunction, canvas: Canvas, rng: Draws) -> SurfaceFields:
    """A grey metal, brushed or hammered, in any colour, with the brightness variation of its F0."""
    colour = metal_colour(rng)[:, None, None]
    under = grey_metal(canvas, rng)
    grey = np.asarray(under.specular)
    return replace(under, diffuse=0.1 * under.diffuse, specular=colour * grey / grey.mean())


def rusted(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Steel with hardly any diffuse albedo, in part covered by dielectric rust."""
    size = rng.log_uniform(0.06, 0.15)
    patch = noise(canvas, "patch", Spectrum(1.3 * size, 0.012, slope=1.6))
    crumbs = noise(canvas, "crumbs", Spectrum(0.03, 0.006, slope=0.8))
    scratch = noise(canvas, "lines", Spectrum(0.04, 0.006, 0.5, stretch=14.0, angle=rng.angle()))
    left, soft = rng.uniform(-0.4, 0.4), rng.log_uniform(0.05, 0.25)
    crust = smoothstep(left - soft, left + soft, patch + 0.2 * crumbs)
    brown = rng.shade(_RUST, 0.3)[:, None, None] * np.exp(0.3 * crumbs)
    steel = METAL_F0["steel"][:, None, None] * np.exp(0.03 * scratch)
    return SurfaceFields(
        mix(_dirt(rng, scratch), brown, crust),
        mix(steel, 0.04 + 0.0 * crumbs, crust),
        mix(rng.uniform(0.2, 0.4) + 0.03 * scratch, 0.82 + 0.04 * crumbs, crust),
        0.01 * mix(0.1 * scratch, 1.0 + 0.5 * crumbs, crust),
        0.5 * crust,
    )


def leafed(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Leaves of gold over red bole, worn through at their edges and where they were rubbed."""
    size = rng.log_uniform(0.16, 0.3)
    turn = rng.angle()
    bend = warp(canvas, "leaves", size, 0.03 * size)
    leaf = cells(canvas, "leaves", size, jitter=0.2, angle=turn, warp=bend)
    edge = smoothstep(0.03, 0.006, border_distance(canvas, leaf))
    rub = noise(canvas, "rub", Spectrum(0.2, 0.012, slope=1.6))
    crinkle = noise(canvas, "crinkle", Spectrum(0.04, 0.008, slope=1.0))
    worn, soft = rng.uniform(1.2, 2.0), rng.log_uniform(0.1, 0.3)
    bare = smoothstep(worn - soft, worn + soft, rub + 0.3 * crinkle + rng.uniform(1.2, 2.4) * edge)
    gold = METAL_F0["gold"] * np.exp(-rng.uniform(0.0, 0.06))
    tone = np.exp(0.08 * (leaf.draw(canvas.stream("tone")) - 1.0))
    bole = rng.shade(_BOLE, 0.25)[:, None, None] * np.exp(0.1 * crinkle)
    return SurfaceFields(
        mix(_dirt(rng, rub), bole, bare),
        mix(gold[:, None, None] * tone, 0.04 + 0.0 * rub, bare),
        mix(rng.uniform(0.16, 0.34) + 0.02 * rub, 0.6 + 0.03 * crinkle, bare),
        0.004 * (crinkle + edge * (1.0 - bare)) - 0.002 * bare,
        bare,
    )


SHEETS: Mapping[str, SurfaceFunction] = MappingProxyType(
    {name: partial(_sheet, name) for name in METAL_F0}
)


# Coats on something else: chipped and worn paint; plaster drawn with a trowel; sand.


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
