"""Random parameters of materials: scales and natural colours; uniform numbers by index (hashes)."""

from __future__ import annotations

import colorsys
import math
import zlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from matcap_lab.simulate.procedural import Canvas, Raster, mix, smoothstep

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
