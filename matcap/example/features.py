"""Features by which places of an exemplar are compared: its maps quantised to small integers.

Every step but the choice of `Scale` is exact arithmetic, elementwise, so that an exemplar and a
scale have the same features on every machine.

Eight planes: square roots of the diffuse albedo's three channels and of F0 (steps that look alike
are numbers alike), roughness, both slopes of the height, and the height itself. Where F0 has a
colour, the first three are of diffuse albedo and F0 together, and the fourth of F0's luminance:
a metal has its colour in F0 alone and what is no metal in its albedo alone, so that these four
distinguish both, in as many numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import Exemplar
from matcap.example.tuned import FEATURE
from matcap.files.rec709 import LUMINANCE

FeatureMap = NDArray[np.int16]

PLANES = 8
LIMIT = 127  # of a feature


@dataclass(frozen=True)
class Scale:
    """How planes become features: (value - offset) * factor, rounded."""

    offsets: NDArray[np.float32]
    factors: NDArray[np.float32]
    """(PLANES,) float32."""


def planes_of(exemplar: Exemplar) -> NDArray[np.float32]:
    """(PLANES, H, W): what features are made of. Height is in texels."""
    maps = (exemplar.diffuse, exemplar.specular, exemplar.roughness, exemplar.height)
    return planes_of_maps(maps, exemplar.texel_size)


def planes_of_maps(maps: tuple[NDArray[np.float32], ...], texel_size: float) -> NDArray[np.float32]:
    """The same of maps that no exemplar holds: diffuse (3, H, W), F0 (1 or 3, H, W), (1, H, W)."""
    diffuse, specular, roughness, heights = maps
    planes = np.empty((PLANES, *heights.shape[1:]), np.float32)
    coloured = len(specular) > 1
    np.sqrt(diffuse + specular if coloured else diffuse, out=planes[:3])
    np.sqrt(_luminance(specular) if coloured else specular[0], out=planes[3])
    planes[4] = roughness[0]
    height = np.divide(heights[0], np.float32(texel_size), out=planes[7])
    _difference(height, planes[5])
    _difference(height.T, planes[6].T)
    return planes


def choose_scale(planes: NDArray[np.float32]) -> Scale:
    """The scale that makes the planes of an exemplar comparable with each other."""
    flat = planes.reshape(PLANES, -1)
    spread = np.maximum(flat.std(axis=1), FEATURE.unseen)
    # Colours keep their proportions, and so do slopes.
    spread[:3] = spread[:3].max()
    spread[5:7] = spread[5:7].max()
    factors = FEATURE.unit * np.array(FEATURE.weights) / spread
    return Scale(flat.mean(axis=1).astype(np.float32), factors.astype(np.float32))


def features_of(planes: NDArray[np.float32], scale: Scale) -> FeatureMap:
    """(PLANES, H, W) integers of at most LIMIT."""
    values = planes - scale.offsets[:, None, None]
    values *= scale.factors[:, None, None]
    np.clip(np.rint(values, out=values), -LIMIT, LIMIT, out=values)
    return values.astype(np.int16)


def halved(features: FeatureMap) -> FeatureMap:
    """(PLANES, H // 2, W // 2): means of two by two, rounded down."""
    rows, columns = features.shape[1] // 2 * 2, features.shape[2] // 2 * 2
    even, odd = features[:, 0:rows:2, :columns], features[:, 1:rows:2, :columns]
    pairs = even + odd
    return (pairs[:, :, 0::2] + pairs[:, :, 1::2] + np.int16(2)) >> np.int16(2)


def smoothed(features: FeatureMap) -> FeatureMap:
    """The same through a filter of 1/4, 1/2, 1/4 along both axes, the border repeated."""
    wide = np.pad(features, ((0, 0), (1, 1), (1, 1)), mode="edge")
    down = (wide[:, :-2] + wide[:, 2:] + np.int16(2) * wide[:, 1:-1] + np.int16(2)) >> np.int16(2)
    return (
        down[:, :, :-2] + down[:, :, 2:] + np.int16(2) * down[:, :, 1:-1] + np.int16(2)
    ) >> np.int16(2)


def _luminance(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) of (3, H, W): sums in a fixed order, for the same bits on every machine."""
    red, green, blue = (np.float32(w) * plane for w, plane in zip(LUMINANCE, colour, strict=True))
    return red + green + blue


def _difference(values: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Central differences along the last axis, one-sided at its ends."""
    out[:, 1:-1] = (values[:, 2:] - values[:, :-2]) * np.float32(0.5)
    out[:, 0] = values[:, 1] - values[:, 0]
    out[:, -1] = values[:, -1] - values[:, -2]
