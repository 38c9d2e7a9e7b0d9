"""Features by which places of an exemplar are compared: its maps quantised to small integers.

Elementwise arithmetic without rounding differences: an exemplar and a Scale give the same features
on every machine.

Eight planes: square roots of diffuse albedo (3) and of F0 (1), roughness, slopes of the height
along x and y, and height. The square root makes steps perceptually about even. Where F0 has a
colour, the first three are square roots of diffuse albedo plus F0, and the fourth of F0's
luminance: metals have their colour in F0, dielectrics in the albedo, so that four planes
distinguish both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import Exemplar
from matcap.files.rec709 import LUMINANCE

# Features of an exemplar's planes; docs/notes/field.md.
UNIT = 32.0  # steps per standard deviation; four deviations fit into LIMIT
# Lower limit of a plane's standard deviation, in the plane's unit; below it the plane is not
# visible, and must not be amplified.
_UNSEEN = (0.01, 0.01, 0.01, 0.02, 0.02, 0.02, 0.02, 0.2)
# Of planes. Height is visible through its slopes only; its weight makes patches join at equal
# heights.
_WEIGHTS = (1.0, 1.0, 1.0, 0.7, 1.0, 1.0, 1.0, 0.5)

FeatureMap = NDArray[np.int16]

PLANES = 8
LIMIT = 127  # largest magnitude of a feature


@dataclass(frozen=True)
class Scale:
    """Quantisation of planes: feature = round((value - offset) * factor), clipped to LIMIT."""

    offsets: NDArray[np.float32]
    """(PLANES,) subtracted from each plane."""
    factors: NDArray[np.float32]
    """(PLANES,) factor on each plane."""


def planes_of(exemplar: Exemplar) -> NDArray[np.float32]:
    """(PLANES, H, W) planes of an exemplar; height is in texels."""
    maps = (exemplar.diffuse, exemplar.specular, exemplar.roughness, exemplar.height)
    return planes_of_maps(maps, exemplar.texel_size)


def planes_of_maps(maps: tuple[NDArray[np.float32], ...], texel_size: float) -> NDArray[np.float32]:
    """(PLANES, H, W) planes of maps.

    Args:
        maps: diffuse (3, H, W), F0 (1 or 3, H, W), roughness (1, H, W), height (1, H, W).
        texel_size: in the height's unit.
    """
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
    """Scale planes by their standard deviations; colours share one, and so do both slopes."""
    flat = planes.reshape(PLANES, -1)
    deviation = np.maximum(flat.std(axis=1), _UNSEEN)
    deviation[:3] = deviation[:3].max()
    deviation[5:7] = deviation[5:7].max()
    factors = UNIT * np.array(_WEIGHTS) / deviation
    return Scale(flat.mean(axis=1).astype(np.float32), factors.astype(np.float32))


def features_of(planes: NDArray[np.float32], scale: Scale) -> FeatureMap:
    """(PLANES, H, W) quantised planes."""
    values = planes - scale.offsets[:, None, None]
    values *= scale.factors[:, None, None]
    np.clip(np.rint(values, out=values), -LIMIT, LIMIT, out=values)
    return values.astype(np.int16)


def halved(features: FeatureMap) -> FeatureMap:
    """(PLANES, H // 2, W // 2) averages of 2 x 2 texels."""
    rows, columns = features.shape[1] // 2 * 2, features.shape[2] // 2 * 2
    even, odd = features[:, 0:rows:2, :columns], features[:, 1:rows:2, :columns]
    pairs = even + odd
    return (pairs[:, :, 0::2] + pairs[:, :, 1::2] + np.int16(2)) >> np.int16(2)


def smoothed(features: FeatureMap) -> FeatureMap:
    """Features filtered by (1/4, 1/2, 1/4) along both axes, borders repeated."""
    wide = np.pad(features, ((0, 0), (1, 1), (1, 1)), mode="edge")
    down = (wide[:, :-2] + wide[:, 2:] + np.int16(2) * wide[:, 1:-1] + np.int16(2)) >> np.int16(2)
    return (
        down[:, :, :-2] + down[:, :, 2:] + np.int16(2) * down[:, :, 1:-1] + np.int16(2)
    ) >> np.int16(2)


def _luminance(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) luminance of (3, H, W), summed in a fixed order for the same bits everywhere."""
    red, green, blue = (np.float32(w) * plane for w, plane in zip(LUMINANCE, colour, strict=True))
    return red + green + blue


def _difference(values: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Central differences along the last axis, one-sided at its ends."""
    out[:, 1:-1] = (values[:, 2:] - values[:, :-2]) * np.float32(0.5)
    out[:, 0] = values[:, 1] - values[:, 0]
    out[:, -1] = values[:, -1] - values[:, -2]
