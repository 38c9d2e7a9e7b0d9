"""Appearance vectors: PCA of texel neighbourhoods, in a few integers (Lefebvre and Hoppe 2006).

Neighbourhoods of 5 x 5 features, weighted towards the middle, projected on their principal
components (Lefebvre and Hoppe 2006). Basis and features are integers of 7 bits, so that every sum
is an integer below 2^24: exact in float32, in whatever order it is added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.features import LIMIT, PLANES, FeatureMap
from matcap.example.library import address, loops
from matcap.example.tuned import APPEARANCE

DIMENSIONS = 8
# Of an appearance: three times a difference of two fits 16 bits, and the sum of its squares over
# four neighbours of eight dimensions 30 bits, and so twice that: (3 * 2 * 700)^2 * 32 = 5.6e8.
LARGEST = 700
_RADIUS = 2
TAPS = (2 * _RADIUS + 1) ** 2 * PLANES  # 200 * 127 * 127 < 2^24

Appearance = NDArray[np.int16]


@dataclass(frozen=True)
class Basis:
    """A projection."""

    weights: NDArray[np.int8]
    """(DIMENSIONS, TAPS) int8, at most LIMIT; taps are rows, columns, planes."""
    shift: int
    """What sums are shifted right by."""
    step: int
    """Of the neighbourhood, in texels of its grid."""


def choose_basis(features: FeatureMap, step: int) -> Basis:
    """Principal components of the neighbourhoods of (PLANES, H, W) features."""
    taps = _taps(features, step)
    places = features.shape[1] * features.shape[2]
    chosen = np.arange(0, places, max(1, places // APPEARANCE.samples))
    rows, columns = np.divmod(chosen, features.shape[2])
    samples = np.concatenate([tap[:, rows, columns] for tap in taps]).astype(np.float64)
    weight = np.repeat(_tap_weights(), PLANES)
    centred = (samples - samples.mean(axis=1, keepdims=True)) * weight[:, None]
    _, components = np.linalg.eigh(centred @ centred.T)
    components = components[:, : -DIMENSIONS - 1 : -1].T * weight
    weights = np.rint(components * (LIMIT / np.abs(components).max())).astype(np.int8)
    sums = np.abs(weights[0].astype(np.float64) @ samples)
    large = max(float(np.quantile(sums, 1.0 - APPEARANCE.clipped)), 1.0)
    return Basis(weights, max(0, math.ceil(math.log2(large / LARGEST))), step)


def project(features: FeatureMap, basis: Basis) -> Appearance:
    """(H, W, DIMENSIONS) of (PLANES, H, W) features, which continue mirrored at the borders.

    Raises:
        MatcapError: the loops were not built.
    """
    rows, columns = features.shape[1:]
    around = np.ascontiguousarray(padded(features, basis).transpose(1, 2, 0))
    weights = np.ascontiguousarray(basis.weights, np.int16)
    projected = np.empty((rows, columns, DIMENSIONS), np.int16)
    loops().matcap_project(
        address(around),
        address(weights),
        basis.step,
        basis.shift,
        columns,
        rows,
        address(projected),
    )
    return projected


def padded(features: FeatureMap, basis: Basis) -> FeatureMap:
    """Features with what their neighbourhoods reach beyond the borders."""
    return _padded(features, _RADIUS * basis.step)


def offsets(step: int) -> list[tuple[int, int]]:
    """(y, x) of every tap from the left top one."""
    side = range(0, (2 * _RADIUS + 1) * step, step)
    return [(y, x) for y in side for x in side]


def _taps(features: FeatureMap, step: int) -> list[FeatureMap]:
    rows, columns = features.shape[1:]
    around = _padded(features, _RADIUS * step)
    return [around[:, y : y + rows, x : x + columns] for y, x in offsets(step)]


def _padded(features: FeatureMap, reach: int) -> FeatureMap:
    return np.pad(features, ((0, 0), (reach, reach), (reach, reach)), mode="symmetric")


def _tap_weights() -> NDArray[np.float64]:
    side = np.arange(-_RADIUS, _RADIUS + 1)
    squares = side[:, None] ** 2 + side[None, :] ** 2
    return np.exp(-squares / APPEARANCE.fall_off).ravel()
