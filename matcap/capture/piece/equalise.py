"""Directional normalisation of relief: equal slope energy everywhere, in every direction.

One flash shows slopes along its direction, hardly across it, and none at the mirror point; the
network shrinks slopes that do not show. Relit, such relief is flat in the middle, with concentric
ridges around it. So every octave is split into directional bands, and the local energy of each is
normalised to its mean over places with high sensitivity in that direction. Octaves are then scaled
to the energies that the photograph measures (strengths.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from matcap.capture.piece.smooth import COARSER, coarse_smoothed, enlarged, split
from matcap.capture.piece.strengths import Strengths, slope_strengths

# Measurement and use of the relief spectrum; docs/notes/capture.md. NSD is the normalised style
# distance.

# Standard deviation of the log ratio of true to predicted energy: common to all bands, and of
# each band. Half or twice as much hardly matters.
_COMMON_LOG, _BAND_LOG = 1.5, 1.0
# Range and step of the log factors searched.
_POSTERIOR_REACH, _POSTERIOR_STEP = 5.0, 0.05
_LEAST_ENERGY = 1e-8  # squared slope, lower limit of standard deviations of energies
# Texels, standard deviation of local energies. Smaller values equalise a cell and its groove (at
# 20 a leather loses 0.1 NSD and a cloth gains as much), larger ones leave arcs around the mirror
# point.
_AROUND = 32.0
_DIRECTIONS = 8  # number of directional bands
_MARGIN = 64  # texels by which a picture is mirrored at its borders
_LEAST_GAIN, _MOST_GAIN = 0.25, 10.0  # limits of the local gain
# Power of the sensitivity as a weight. Larger values use only places where the light is parallel
# to the direction.
_SHARPNESS = 3.0
_ROUNDS = 3  # iterations of scaling bands to their energies, as neighbours overlap
# Largest factor on a band. At 5, leather's finest octave, which needs 11, stays too flat.
_MOST_FACTOR = 30.0
_LEAST_SLOPE = 1e-4  # root-mean-square slope, lower limit of a band's

Height = NDArray[np.float32]
Doubles = NDArray[np.float64]


def equalise(
    height: Height, strengths: Strengths | None, sensitivity: Height | None = None
) -> Height:
    """Height (H, W) in texels, with local slope energies equalised and bands scaled to `strengths`.

    Args:
        height: (H, W) predicted, texels.
        strengths: measured in the photograph; None keeps each band's mean energy.
        sensitivity: (2, H, W) d log L / d slope along x and y (upwards); None for a constant.
    """
    # The low-pass rest is an error of the highlight, shaped like a bowl, and is dropped.
    bands = split(height)[:-1]
    seen = _squares(np.ones((2, *height.shape), np.float32) if sensitivity is None else sensitivity)
    margin = min(_MARGIN, *(side - 1 for side in height.shape))
    directions = [
        (share, _weight(angle, seen))
        for angle, share in _directions(tuple(side + 2 * margin for side in height.shape))
    ]
    with ThreadPoolExecutor() as pool:
        evened = partial(_evened, margin=margin, directions=directions)
        even = np.stack(list(pool.map(evened, bands)))
    wanted = _wanted(height, strengths)
    factors: Doubles = np.ones(len(even))
    most = _MOST_FACTOR
    for _ in range(_ROUNDS):
        here = _energies(_sum(factors, even))
        factors = (factors * np.sqrt(wanted / here)).clip(1.0 / most, most)
    return _sum(factors, even)


def _sum(factors: Doubles, bands: Height) -> Height:
    """(H, W) sum of factors (N,) times bands (N, H, W), in fixed order for identical bits."""
    return np.asarray(np.einsum("n,nhw->hw", factors, bands, optimize=False), np.float32)


def _squares(sensitivity: Height) -> Height:
    """(3, h, w) products xx, xy and yy of the sensitivity, on the grid of coarse_smoothed."""
    x, y = sensitivity
    return np.stack([coarse_smoothed(product, COARSER) for product in (x * x, x * y, y * y)])


def _evened(band: Height, margin: int, directions: Sequence[tuple[Height, Doubles]]) -> Height:
    """Normalise the local energy of a band (H, W) in each direction to its mean where it shows.

    Args:
        band: of the relief.
        margin: texels by which it is mirrored at its borders.
        directions: filter of each direction (_directions), and weights of its energy (_weight).
    """
    height, width = band.shape
    padded = np.pad(band, margin, mode="reflect")
    spectrum = np.fft.rfft2(padded)
    inside = slice(margin, margin + height), slice(margin, margin + width)
    even = np.zeros_like(band)
    for share, weight in directions:
        waves = np.fft.irfft2(spectrum * share, s=padded.shape)[inside].astype(np.float32)
        energy = coarse_smoothed(np.square(waves), _AROUND)
        wanted = float((weight * energy).sum() / weight.sum())
        gain = np.sqrt(wanted / np.maximum(energy, 1e-20))
        gain = gain.clip(_LEAST_GAIN, _MOST_GAIN).astype(np.float32)
        even += enlarged(gain, band.shape) * waves
    return even


def _weight(angle: float, seen: Height) -> Doubles:
    """(h, w) weight of places by their sensitivity to slopes along `angle`, from _squares."""
    c, s = np.cos(angle), np.sin(angle)
    xx, xy, yy = seen.astype(np.float64)
    weight = np.maximum(c * c * xx + 2.0 * c * s * xy + s * s * yy, 0.0)
    return np.asarray((weight / max(float(weight.max()), 1e-12)) ** _SHARPNESS + 1e-9)


def _directions(shape: tuple[int, ...]) -> list[tuple[float, Height]]:
    """Angles in [0, pi), y upwards, and the filter on a real spectrum (h, w // 2 + 1) of each.

    The filters overlap smoothly and sum to 1.
    """
    count = _DIRECTIONS
    fx, fy = np.fft.rfftfreq(shape[1]), -np.fft.fftfreq(shape[0])[:, None]
    along = np.arctan2(fy, fx + np.zeros_like(fy))
    directions = []
    for angle in np.arange(count) * np.pi / count:
        off = (along - angle + np.pi / 2.0) % np.pi - np.pi / 2.0
        share = np.where(np.abs(off) < np.pi / count, np.square(np.cos(off * count / 2.0)), 0.0)
        directions.append((float(angle), share.astype(np.float32)))
    return directions


def _energies(height: Height) -> Doubles:
    """(len(BANDS),) mean squared slopes of a height (H, W) in texels."""
    return np.square(slope_strengths(height)).sum(1).clip(_LEAST_SLOPE**2)


def _wanted(height: Height, strengths: Strengths | None) -> Doubles:
    """(len(BANDS),) posterior slope energies (posterior_energies)."""
    predicted = _energies(height)
    if strengths is None:
        return predicted
    return posterior_energies(predicted, np.square(strengths.slope).sum(1), strengths.deviation)


def posterior_energies(predicted: Doubles, measured: Doubles, deviation: Doubles) -> Doubles:
    """(bands,) squared slopes: MAP estimate from a prediction and a measurement of each band.

    With p_b the network's energy of band b, m_b and d_b the measured one and its deviation,

        minimise  sum_b ((p_b e^{x_b} - m_b) / d_b)^2 + sum_b ((x_b - c) / s)^2 + (c / t)^2

    over the log factors x_b of each band and c common to all (s: _BAND_LOG, t: _COMMON_LOG).
    The network shrinks uncertain relief by a factor common to all bands and a smaller one per band.
    Well-measured bands take the measurement; bands measured as zero shrink by the inverse of its
    variance; bands without a measurement follow c.

    Args:
        predicted: (bands,) squared slopes of the network's relief, positive.
        measured: (bands,) by the photograph, not negative.
        deviation: (bands,) standard deviations of `measured`.
    """
    reach, step = _POSTERIOR_REACH, _POSTERIOR_STEP
    logs = np.arange(-reach, reach + step / 2.0, step)
    scatter = deviation[:, None] + _LEAST_ENERGY
    off = np.square((predicted[:, None] * np.exp(logs) - measured[:, None]) / scatter)
    # (common, band, own): c, b and x_b of the docstring.
    own_cost = np.square((logs - logs[:, None]) / _BAND_LOG)[:, None, :]
    price = own_cost + off
    best = price.argmin(-1)
    total = price.min(-1).sum(1) + np.square(logs / _COMMON_LOG)
    return np.asarray(predicted * np.exp(logs[best[total.argmin()]]))
