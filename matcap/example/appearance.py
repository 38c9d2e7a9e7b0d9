"""Appearance vectors: PCA of texel neighbourhoods [lefebvre2006], in integers.

Neighbourhoods of 5 x 5 features, with Gaussian weights, are projected on their principal
components. Basis and features are integers of 7 bits plus sign, so that sums are integers below
2^24, exact whatever their order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.features import LIMIT, PLANES, FeatureMap
from matcap.example.library import address, loops

# Appearance vectors; docs/notes/field.md.
_FALL_OFF = 8.0  # f of the neighbourhood's weights exp(-r^2 / f), in squared steps
_SAMPLES = 20_000  # neighbourhoods that the PCA is computed from
_CLIPPED = 0.002  # share of places whose first component exceeds appearance.LARGEST

DIMENSIONS = 8
# Limit of an appearance, chosen so that kernel.c's costs fit 32 bits: over four neighbours of eight
# dimensions (3 * 2 * 700)^2 * 32 = 5.6e8, and twice that.
LARGEST = 700
_RADIUS = 2
TAPS = (2 * _RADIUS + 1) ** 2 * PLANES  # 200 * 127 * 127 < 2^24

Appearance = NDArray[np.int16]


@dataclass(frozen=True)
class Basis:
    """Projection of a neighbourhood to an appearance vector: (weights @ neighbourhood) >> shift."""

    weights: NDArray[np.int8]
    """(DIMENSIONS, TAPS), at most LIMIT; taps are ordered by row, column, plane."""
    shift: int
    """Right shift of the projected values, bits."""
    step: int
    """Distance of the neighbourhood's texels, in texels of the features' grid."""


def choose_basis(features: FeatureMap, step: int) -> Basis:
    """Principal components of neighbourhoods of (PLANES, H, W) features, `step` texels apart."""
    taps = _taps(features, step)
    places = features.shape[1] * features.shape[2]
    chosen = np.arange(0, places, max(1, places // _SAMPLES))
    rows, columns = np.divmod(chosen, features.shape[2])
    samples = np.concatenate([tap[:, rows, columns] for tap in taps]).astype(np.float64)
    weight = np.repeat(_tap_weights(), PLANES)
    centred = (samples - samples.mean(axis=1, keepdims=True)) * weight[:, None]
    _, components = np.linalg.eigh(centred @ centred.T)
    components = components[:, : -DIMENSIONS - 1 : -1].T * weight
    weights = np.rint(components * (LIMIT / np.abs(components).max())).astype(np.int8)
    sums = np.abs(weights[0].astype(np.float64) @ samples)
    large = max(float(np.quantile(sums, 1.0 - _CLIPPED)), 1.0)
    return Basis(weights, max(0, math.ceil(math.log2(large / LARGEST))), step)


def project(features: FeatureMap, basis: Basis) -> Appearance:
    """(H, W, DIMENSIONS) appearance of (PLANES, H, W) features, mirrored at the borders.

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
    """Features padded, by mirroring, for the neighbourhoods of their border texels."""
    return _padded(features, _RADIUS * basis.step)


def offsets(step: int) -> list[tuple[int, int]]:
    """(y, x) of every tap, from the upper left one."""
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
    return np.exp(-squares / _FALL_OFF).ravel()
