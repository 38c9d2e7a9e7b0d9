"""An endless stream of random materials: their parameters, patterns and layers."""

from __future__ import annotations

import colorsys
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap_lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    VoronoiCells,
    assemble,
    cells,
    colour,
    displacement,
    mix,
    noise,
    rms_slope,
    smoothstep,
    weave,
)

Integers = NDArray[np.int64]
Colours = NDArray[np.float64]  # (3,) linear Rec.709 albedo

# Diffuse albedos, linear Rec.709, of common materials.
STONES = np.array(
    [
        [0.42, 0.40, 0.37],
        [0.22, 0.21, 0.20],
        [0.09, 0.09, 0.09],
        [0.05, 0.055, 0.06],
        [0.55, 0.48, 0.38],
        [0.36, 0.27, 0.19],
        [0.30, 0.17, 0.12],
        [0.62, 0.60, 0.56],
        [0.20, 0.23, 0.19],
        [0.17, 0.20, 0.25],
    ]
)
CLAYS = np.array(
    [
        [0.34, 0.13, 0.07],
        [0.42, 0.20, 0.11],
        [0.24, 0.09, 0.055],
        [0.50, 0.33, 0.19],
        [0.16, 0.075, 0.055],
        [0.58, 0.48, 0.36],
        [0.30, 0.28, 0.26],
        [0.68, 0.65, 0.60],
    ]
)
WOODS = np.array(
    [
        [0.44, 0.27, 0.13],
        [0.30, 0.16, 0.07],
        [0.14, 0.065, 0.03],
        [0.56, 0.41, 0.24],
        [0.22, 0.09, 0.04],
        [0.05, 0.032, 0.022],
        [0.33, 0.30, 0.26],
        [0.64, 0.53, 0.37],
    ]
)
METALS = np.array(  # what little diffuse light dirt and oxide give
    [
        [0.030, 0.030, 0.031],
        [0.050, 0.046, 0.040],
        [0.055, 0.036, 0.020],
        [0.022, 0.023, 0.026],
        [0.075, 0.072, 0.068],
    ]
)


class Draws(np.random.Generator):
    """Random numbers, and what is drawn of materials by them."""

    @classmethod
    def of(cls, seed: int | Sequence[int]) -> Draws:
        """The numbers of `numpy.random.default_rng` of the same seed."""
        return cls(np.random.PCG64(seed))

    def log_uniform(self, low: float, high: float) -> float:
        """A number whose logarithm is uniform."""
        return float(math.exp(self.uniform(math.log(low), math.log(high))))

    def chance(self, probability: float) -> bool:
        """True with a probability."""
        return bool(self.random() < probability)

    def angle(self) -> float:
        """A direction of grain, radians: half the time along the picture's sides."""
        if self.chance(0.5):
            return float(self.choice([0.0, math.pi / 2]) + self.normal(0.0, 0.03))
        return float(self.uniform(0.0, math.pi))

    def natural(self, palette: Colours) -> Colours:
        """(3,) a colour near one of a palette's (N, 3)."""
        return self.shade(palette[self.integers(len(palette))], 0.3, 0.08)

    def dye(self) -> Colours:
        """(3,) a colour, greys and browns more often than others."""
        if self.chance(0.4):
            return self.natural(np.concatenate([STONES, WOODS]))
        saturation, value = self.beta(2.0, 1.5), self.log_uniform(0.03, 0.8)
        return np.array(colorsys.hsv_to_rgb(self.random(), saturation, value))

    def shade(self, of: Colours, tone: float, hue: float = 0.06) -> Colours:
        """(3,) a variation of a colour: log-normal in brightness by `tone`, warmth by `hue`.

        Dirt, heat and age change colours along warm-cool, hardly along green-magenta.
        """
        light, warm, green = self.standard_normal(3)
        warmth, tint = np.array([1.0, 0.1, -1.1]), np.array([-0.12, 0.12, -0.12])
        factor = np.exp(tone * light + hue * (warm * warmth + green * tint))
        return np.asarray(np.clip(of * factor, 0.01, 0.88))

    def shades(self, of: Colours, count: int, tone: float) -> Colours:
        """(count, 3) variations of a colour."""
        return np.stack([self.shade(of, tone, 0.4 * tone) for _ in range(count)])

    def dielectric(self) -> float:
        """F0 of water-like to gem-like, most often near glass."""
        return float(np.clip(self.normal(0.042, 0.008), 0.025, 0.07))


def cell_noise(canvas: Canvas, label: str, *indices: Integers) -> Raster:
    """A uniform number in [0, 1) for every tuple of integers, any sign: a hash with the seed.

    The finaliser of SplitMix64 [steele2014], applied once per index.
    """
    key = (canvas.seed * 0x9E3779B97F4A7C15 + zlib.crc32(label.encode())) % 2**64
    state: NDArray[np.uint64] = np.array(key, dtype=np.uint64)
    for index in indices:
        state = (state ^ index.astype(np.int64).view(np.uint64)) + np.uint64(0x9E3779B97F4A7C15)
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state = state ^ (state >> np.uint64(31))
    return (state >> np.uint64(11)).astype(np.float64) * 2.0**-53


def value_noise(canvas: Canvas, label: str, across: Raster, *indices: Integers) -> Raster:
    """Smooth random lines in [-1, 1]: a function of `across` for each tuple of indices."""
    first = np.floor(across).astype(np.int64)
    low = cell_noise(canvas, label, first, *indices)
    high = cell_noise(canvas, label, first + 1, *indices)
    return 2.0 * mix(low, high, smoothstep(0.0, 1.0, across - first)) - 1.0


# Patterns for the endless stream of random materials: each a mask and a relief.
#
# A mask in [0, 1] blends a layer's two finishes; a relief is a height of any scale, which the layer
# scales to a slope.


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
    crease = np.exp(-((cell.border / (0.08 + 0.4 * shape.share)) ** 2))
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
    return 0.6 * relief + 0.4 * (dye < shape.share), relief


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


# An endless stream of varied stationary materials, for training.
#
# A material has one or two layers; a layer has a pattern, two finishes blended by the pattern's
# mask, a relief, and fine grain. A second layer covers the first in patches.

Colour = tuple[float, float, float]

# Excluded from training: networks are evaluated on them.
HELD_OUT_PATTERNS = ("creases", "woven")
_WEIGHTS = {"clouds": 3.0, "creases": 1.5, "grains": 1.5, "woven": 1.5}  # 1 of the others


@dataclass(frozen=True)
class Finish:
    """A uniform surface: diffuse albedo (linear), F0 and roughness."""

    diffuse: Colour
    specular: float
    roughness: float


@dataclass(frozen=True)
class Layer:
    """A pattern of two finishes."""

    pattern: str
    """A key of PATTERNS."""
    shape: PatternShape
    """Parameters of the pattern."""
    first: Finish
    second: Finish
    """Finishes where the pattern's mask is 0 and 1."""
    depth: float
    """Plane units per unit of the pattern's relief."""
    grain: Spectrum
    """Spectrum of the fine variation."""
    tone: float
    """Standard deviation of the logarithm of albedo by grain."""
    wear: float
    """Standard deviation of roughness by grain."""
    grain_depth: float
    """Standard deviation of the grain's height, plane units."""


@dataclass(frozen=True)
class RandomMaterial:
    """One material of the stream."""

    base: Layer
    """The lower layer."""
    cover: Layer | None
    """The upper one, or None."""
    patches: Spectrum
    """Spectrum of the noise whose threshold is the cover's mask."""
    covered: float
    """Threshold; the cover lies where the noise is larger."""
    edge: float
    """Width of the transition, in standard deviations of the noise."""
    thickness: float
    """Thickness of the upper layer, plane units."""

    @property
    def is_held_out(self) -> bool:
        """Whether it has a pattern of HELD_OUT_PATTERNS."""
        layers = (self.base, self.cover)
        return any(one is not None and one.pattern in HELD_OUT_PATTERNS for one in layers)

    def realise(self, width: int, height: int, seed: int, texel_size: float) -> MapSet:
        """One realisation, float64 (C, height, width); see materials.realise."""
        canvas = Canvas(width, height, texel_size, seed)
        fields = _lay(canvas, "base", self.base)
        if self.cover is not None:
            patch = noise(canvas, "patches", self.patches)
            share = smoothstep(self.covered - self.edge, self.covered + self.edge, patch)
            upper = _lay(canvas, "cover", self.cover)
            upper = (*upper[:3], upper[3] + self.thickness)
            diffuse, specular, roughness, relief = (
                mix(low, high, share) for low, high in zip(fields, upper, strict=True)
            )
            fields = diffuse, specular, roughness, relief
        return assemble(canvas, *fields)


def random_material(generator: np.random.Generator) -> RandomMaterial:
    """Draw a material; its features repeat at least eight times across a photograph."""
    rng = Draws(generator.bit_generator)
    hue = _natural_colour(rng)
    base = _random_layer(rng, hue)
    layered = rng.random() < 0.35
    patch = rng.log_uniform(0.05, 0.16)
    return RandomMaterial(
        base=base,
        cover=_random_layer(rng, hue if rng.random() < 0.4 else _natural_colour(rng))
        if layered
        else None,
        patches=Spectrum(patch, rng.log_uniform(0.008, 0.04), rng.uniform(0.8, 2.0)),
        covered=rng.uniform(-0.5, 1.0),
        edge=rng.log_uniform(0.06, 0.8),
        thickness=rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 0.003),
    )


def _lay(canvas: Canvas, label: str, layer: Layer) -> tuple[Raster, Raster, Raster, Raster]:
    """Diffuse, specular, roughness and height of a layer."""
    mask, relief = PATTERNS[layer.pattern](canvas, label, layer.shape)
    grain = noise(canvas, label + " grain", layer.grain)
    first, second = layer.first, layer.second
    tone = np.exp(layer.tone * grain)
    return (
        mix(colour(*first.diffuse), colour(*second.diffuse), mask) * tone,
        first.specular + (second.specular - first.specular) * mask,
        first.roughness + (second.roughness - first.roughness) * mask + layer.wear * grain,
        layer.depth * relief + layer.grain_depth * grain,
    )


def _random_layer(rng: Draws, hue: Colour) -> Layer:
    weights = [_WEIGHTS.get(name, 1.0) for name in PATTERNS]
    pattern = str(rng.choice(list(PATTERNS), p=[weight / sum(weights) for weight in weights]))
    scale = rng.log_uniform(0.018, 0.16)
    fine = min(rng.log_uniform(0.006, 0.03), 0.7 * scale)
    shape = PatternShape(
        scale=scale,
        fine=fine,
        slope=rng.uniform(0.3, 2.0),
        stretch=rng.log_uniform(1.5, 8.0) if rng.random() < 0.3 else 1.0,
        angle=rng.uniform(0.0, math.pi) if rng.random() < 0.6 else rng.choice([0.0, math.pi / 2]),
        sharpness=rng.random(),
        share=rng.random(),
        irregularity=rng.random(),
        variant=int(rng.integers(3)),
    )
    first = _random_finish(rng, hue)
    coarse = rng.log_uniform(0.012, 0.1)
    grain = Spectrum(
        coarse,
        min(rng.log_uniform(0.006, 0.015), 0.7 * coarse),
        rng.uniform(0.3, 1.6),
        stretch=shape.stretch if rng.random() < 0.5 else 1.0,
        angle=shape.angle,
    )
    layer = Layer(
        pattern=pattern,
        shape=shape,
        first=first,
        second=_related_finish(rng, first),
        depth=1.0,
        grain=grain,
        tone=rng.log_uniform(0.01, 0.3),
        wear=rng.log_uniform(0.003, 0.06),
        grain_depth=1.0,
    )
    flat = rng.random() < 0.2
    pattern_slope = 0.02 if flat else rng.log_uniform(0.04, 0.4)
    grain_slope = rng.log_uniform(0.005, 0.15)
    pattern_unit, grain_unit = _unit_slopes(layer)
    return replace(layer, depth=pattern_slope / pattern_unit, grain_depth=grain_slope / grain_unit)


def _unit_slopes(layer: Layer) -> tuple[float, float]:
    """Root mean square slopes of a layer's relief and grain at depth 1, measured on a sample."""
    texel = 2.0 / 512.0
    canvas = Canvas(192, 144, texel, seed=0)
    relief = PATTERNS[layer.pattern](canvas, "base", layer.shape)[1]
    grain = noise(canvas, "base grain", layer.grain)

    return max(rms_slope(relief, texel), 1.0), max(rms_slope(grain, texel), 1.0)


def _natural_colour(rng: Draws) -> Colour:
    """A diffuse albedo: browns and greys most often, any hue at times."""
    if rng.random() < 0.6:
        hue, saturation = rng.normal(0.08, 0.04) % 1.0, rng.uniform(0.0, 0.7)
    else:
        hue, saturation = rng.random(), rng.beta(1.5, 1.5)
    return colorsys.hsv_to_rgb(hue, saturation, rng.log_uniform(0.03, 0.85))


def _random_finish(rng: Draws, hue: Colour) -> Finish:
    if rng.random() < 0.18:
        darkness = rng.uniform(0.02, 0.15)
        metal = tuple(darkness * channel for channel in hue)
        return Finish((metal[0], metal[1], metal[2]), rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.7))
    return Finish(hue, rng.uniform(0.025, 0.07), rng.uniform(0.15, 0.92))


def _related_finish(rng: Draws, first: Finish) -> Finish:
    """A finish of a similar colour to another, at times of an unrelated one."""
    if rng.random() < 0.25:
        return _random_finish(rng, _natural_colour(rng))
    factor = rng.log_uniform(0.3, 2.5)
    shifted = [min(0.9, channel * factor * rng.uniform(0.85, 1.15)) for channel in first.diffuse]
    return Finish(
        (shifted[0], shifted[1], shifted[2]),
        float(np.clip(first.specular * rng.uniform(0.7, 1.3), 0.02, 0.95)),
        float(np.clip(first.roughness + rng.normal(0.0, 0.15), 0.12, 0.95)),
    )
