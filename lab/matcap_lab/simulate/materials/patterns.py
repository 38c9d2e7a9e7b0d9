"""Patterns for the endless stream of random materials: each a mask and a relief.

A mask in [0, 1] blends a layer's two finishes; a relief is a height of any scale, which the layer
scales to a slope.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from matcap_lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    VoronoiCells,
    cells,
    displacement,
    noise,
    smoothstep,
    weave,
)


@dataclass(frozen=True)
class PatternShape:
    """The parameters that all patterns share; each uses what it can."""

    scale: float
    """Size of a feature in plane units."""
    fine: float
    """Size of the finest detail in plane units."""
    slope: float
    """Amplitude is f^-slope."""
    stretch: float
    """How much longer features are along the grain than across it."""
    angle: float
    """Angle of the grain, radians anticlockwise from x."""
    sharpness: float
    """0 for soft masks to 1 for hard ones."""
    share: float
    """Approximate coverage of the mask, 0 to 1."""
    irregularity: float
    """0 for a perfect lattice to 1."""
    variant: int
    """Form of the pattern, 0, 1 or 2."""

    @property
    def spectrum(self) -> Spectrum:
        """Noise of this scale, slope and grain."""
        return Spectrum(self.scale, self.fine, self.slope, self.stretch, self.angle)


# (mask, relief)
Pattern = Callable[[Canvas, str, PatternShape], tuple[Raster, Raster]]


def clouds(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Noise: plain, ridged or billowing."""
    field = noise(canvas, label, shape.spectrum)
    if shape.variant == 1:
        field = 1.3 - 2.0 * np.abs(field)
    elif shape.variant == 2:
        field = 2.0 * np.abs(field) - 1.3
    return _threshold(field, shape), field


def grains(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Cells that each choose their colour: crystals, pebbles, hammer marks."""
    cell = _cells(canvas, label, shape)
    each = cell.draw(canvas.stream(label + " each"))
    mask = each if shape.sharpness < 0.5 else (each < shape.share).astype(np.float64)
    if shape.variant == 0:
        return mask, smoothstep(0.0, 0.5, cell.border)
    if shape.variant == 1:
        return mask, cell.nearest**2
    return mask, 0.3 * each * smoothstep(0.0, 0.25, cell.border)


def creases(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Plates parted by creases: leather, cracks, scales."""
    cell = _cells(canvas, label, shape)
    width = 0.08 + 0.4 * shape.share
    crease = np.exp(-((cell.border / width) ** 2))
    dome = 1.0 - cell.nearest**2 if shape.variant else 0.0
    return crease, 0.5 * dome * (1.0 - crease) - 0.5 * crease


def spots(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Separate round spots: speckle, pores, dimples, studs."""
    cell = _cells(canvas, label, shape)
    radius = 0.15 + 0.3 * cell.draw(canvas.stream(label + " size"))
    there = cell.draw(canvas.stream(label + " there")) < 0.3 + 0.7 * shape.share
    edge = 0.6 - 0.5 * shape.sharpness
    mask = smoothstep(0.0, edge, 1.0 - cell.nearest / radius) * there
    return mask, mask if shape.variant else -mask


def woven(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Plain weave or twill; the mask separates warp from weft and varies by thread."""
    u, v = _lattice(canvas, label, shape)
    threads = weave(u, v, over=shape.variant + 1, fill=0.8 + 0.2 * shape.share, depth=0.3)
    dye = threads.per_thread(canvas.stream(label + " dye"))
    warp = threads.warp_on_top.astype(np.float64)
    gap = smoothstep(0.0, 0.3, threads.height)
    mask = (0.25 + 0.5 * warp * shape.sharpness + 0.12 * dye) * gap
    return np.clip(mask, 0.0, 1.0), threads.height


def knit(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Columns of V-shaped stitches."""
    u, v = _lattice(canvas, label, shape)
    fold = np.abs(2.0 * (u - np.floor(u)) - 1.0)
    stitch = v + 0.5 * fold
    along = 2.0 * math.pi * (stitch - np.floor(stitch))
    row = np.floor(stitch).astype(np.int64)
    relief = np.sqrt(np.clip(1.0 - (2.0 * fold - 1.0) ** 2, 0.0, 1.0)) * (0.6 + 0.4 * np.cos(along))
    dye = canvas.stream(label + " dye").random(int(row.max()) + 1)[row]
    mask = 0.6 * relief + 0.4 * (dye < shape.share)
    return mask, relief


def ribs(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Stripes: corduroy, wood grain, ripples."""
    u, _ = _lattice(canvas, label, shape)
    wave = np.sin(2.0 * math.pi * u)
    relief = np.abs(wave) if shape.variant else wave
    return _threshold(1.4 * wave, shape), relief


def scratches(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Long fine lines in one direction (brushed) or a few."""
    total = np.zeros((canvas.height, canvas.width))
    for turn in range(1 + shape.variant):
        lines = Spectrum(
            coarse=4.0 * shape.fine,
            fine=shape.fine,
            slope=0.3,
            stretch=8.0 + 20.0 * shape.irregularity,
            angle=shape.angle + 1.1 * turn,
        )
        total = total + noise(canvas, f"{label} {turn}", lines)
    total = total / math.sqrt(1 + shape.variant)
    return _threshold(total, shape), total


def tiles(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Square tiles, bricks or planks with joints."""
    u, v = _lattice(canvas, label, shape)
    row = np.floor(v).astype(np.int64)
    wide = u / (1.0 + shape.variant) + 0.5 * (row % 2) * (shape.variant > 0)
    column = np.floor(wide).astype(np.int64)
    across, down = 2.0 * np.abs(wide - column - 0.5), 2.0 * np.abs(v - row - 0.5)
    joint = 0.08 + 0.15 * shape.share
    inside = np.minimum((1.0 - across) * (1.0 + shape.variant), 1.0 - down)
    body = smoothstep(0.5 * joint, 1.2 * joint, inside)
    count = int(column.max()) + 1
    each = canvas.stream(label + " each").random((int(row.max()) + 1) * count)[row * count + column]
    return body * (0.4 + 0.6 * each), body + 0.4 * smoothstep(0.0, 0.8, inside)


PATTERNS: Mapping[str, Pattern] = MappingProxyType(
    {
        "clouds": clouds,
        "grains": grains,
        "creases": creases,
        "spots": spots,
        "woven": woven,
        "knit": knit,
        "ribs": ribs,
        "scratches": scratches,
        "tiles": tiles,
    }
)


def _threshold(field: Raster, shape: PatternShape) -> Raster:
    """Mask of a field of about unit variance, thresholded for a coverage of `shape.share`."""
    middle = 1.6 - 3.2 * shape.share
    half = 1.5 * (1.0 - shape.sharpness) + 0.12
    return smoothstep(middle - half, middle + half, field)


def _cells(canvas: Canvas, label: str, shape: PatternShape) -> VoronoiCells:
    warp = None
    if shape.irregularity > 0.3:
        bend = Spectrum(coarse=1.5 * shape.scale, fine=max(shape.fine, 0.4 * shape.scale))
        deviation = 0.12 * shape.scale * shape.irregularity
        warp = displacement(canvas, label + " bend", bend, deviation)
    return cells(
        canvas,
        label,
        shape.scale,
        jitter=0.4 + 0.6 * shape.irregularity,
        stretch=min(shape.stretch, 3.0),
        angle=shape.angle,
        warp=warp,
    )


def _lattice(canvas: Canvas, label: str, shape: PatternShape) -> tuple[Raster, Raster]:
    """Rotated and slightly warped coordinates u, v in units of `scale`; not negative."""
    cosine, sine = math.cos(shape.angle), math.sin(shape.angle)
    u = (canvas.x * cosine - canvas.y * sine) / shape.scale
    v = (canvas.x * sine + canvas.y * cosine) / (shape.scale * min(shape.stretch, 1.5))
    bend = Spectrum(coarse=4.0 * shape.scale, fine=1.5 * shape.scale)
    reach = 0.12 * shape.irregularity
    start = canvas.stream(label + " place").uniform(2.0, 3.0, size=2)
    u = u + reach * noise(canvas, label + " bend u", bend)
    v = v + reach * noise(canvas, label + " bend v", bend)
    extent_x, extent_y = canvas.extent
    # An offset that keeps coordinates positive for every rotation of the lattice.
    corner = math.ceil((extent_x + extent_y) / shape.scale) + start
    return u + corner[0], v + corner[1]
