"""An endless stream of varied stationary materials, for training.

A material has one or two layers; a layer has a pattern, two finishes blended by the pattern's mask,
a relief, and fine grain. A second layer covers the first in patches.
"""

from __future__ import annotations

import colorsys
import math
from dataclasses import dataclass, replace

import numpy as np

from matcap.brdf.maps import MapSet
from matcap_lab.simulate.materials.assemble import assemble
from matcap_lab.simulate.materials.draws import Draws
from matcap_lab.simulate.materials.patterns import PATTERNS, PatternShape
from matcap_lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    colour,
    mix,
    noise,
    rms_slope,
    smoothstep,
)

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
