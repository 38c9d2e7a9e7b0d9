"""Octave bands of planes of texels, and Gaussian averages over many texels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.files.threads import at_once
from matcap.photo.left_out import area_averaged

# Longest and shortest wavelength of each band, texels.
BANDS = tuple(pairwise((64.0, 32.0, 16.0, 8.0, 4.0, 2.8, 2.0)))
COARSER = 8  # subsampling, texels, of wide blurs. Larger values are faster and leave cells.
# The long side over the standard deviation of the blur that takes light and shading, not texture.
WIDE = 12.0
_FEW = 0.2  # share of a transform's sides below which a product of matrices is faster than it
_SOFT = 0.25  # octaves, half width of the transition between bands. Smaller values ring.

ChannelPlane = NDArray[np.float32]


def smoothed(plane: ChannelPlane, deviation: float) -> ChannelPlane:
    """Blur a plane (H, W) by a Gaussian; the standard deviation is many texels."""
    return enlarged(coarse_smoothed(plane, deviation), plane.shape)


def local_mean(plane: ChannelPlane, weight: ChannelPlane, deviation: float) -> ChannelPlane:
    """Local mean of a plane (H, W), by a Gaussian times weights (H, W) of the texels."""
    whole = np.maximum(smoothed(weight, deviation), np.float32(1e-3))
    return np.asarray(smoothed(plane * weight, deviation) / whole, np.float32)


def coarse_smoothed(plane: ChannelPlane, deviation: float) -> ChannelPlane:
    """Gaussian blur of a plane (H, W), on a grid coarser by COARSER."""
    rows, columns = plane.shape
    size = (max(1, columns // COARSER), max(1, rows // COARSER))
    thin = area_averaged(plane, size)
    return np.asarray(cv2.GaussianBlur(thin, (0, 0), deviation / COARSER), np.float32)


def enlarged(plane: ChannelPlane, shape: tuple[int, ...]) -> ChannelPlane:
    """Interpolate a plane bilinearly to `shape` (H, W)."""
    size = (shape[1], shape[0])
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR), np.float32)


def filled(plane: ChannelPlane, known: NDArray[np.bool_]) -> ChannelPlane:
    """Interpolate the unknown texels of a plane (H, W) from the known ones around them.

    Pull-push [gortler1996]; 0 if nothing is known.
    """
    if known.all() or min(plane.shape) < 2:
        return np.where(known, plane, np.float32(0.0))
    size = tuple((side + 1) // 2 for side in plane.shape[::-1])
    weight = known.astype(np.float32)
    share = area_averaged(weight, size)
    total = area_averaged(plane * weight, size)
    means = np.asarray(total / np.maximum(share, np.float32(1e-6)), np.float32)
    return np.where(known, plane, enlarged(filled(means, share > 1e-3), plane.shape))


def split(plane: ChannelPlane, bands: Sequence[tuple[float, float]] = BANDS) -> list[ChannelPlane]:
    """Band-pass components (H, W) of a plane, by wavelength in texels, and the low-pass rest.

    Longest band first, the rest last; they sum to the plane.
    """
    waves, shares = _waves_of(plane), _shares(plane.shape, tuple(bands))
    return list(at_once(*(partial(_of_waves, waves, share, plane.shape) for share in shares)))


def split_all(
    planes: Sequence[ChannelPlane], bands: Sequence[tuple[float, float]]
) -> Iterator[list[ChannelPlane]]:
    """Band by band, the components of planes of one size, as `split` orders them."""
    shape = planes[0].shape
    waves = at_once(*(partial(_waves_of, plane) for plane in planes))
    for share in _shares(shape, tuple(bands)):
        yield list(at_once(*(partial(_of_waves, each, share, shape) for each in waves)))


def _waves_of(plane: ChannelPlane) -> ChannelPlane:
    """Cosine transform of a plane, whose sides are made even."""
    even = [(0, side % 2) for side in plane.shape]
    return np.asarray(cv2.dct(np.pad(plane, even, mode="edge").astype(np.float32)), np.float32)


@lru_cache(maxsize=1)
def _shares(
    shape: tuple[int, ...], bands: tuple[tuple[float, float], ...]
) -> tuple[ChannelPlane, ...]:
    """(H, W) each: share of a plane's cosines that is in each of the bands, and in the rest."""
    rows, columns = (np.arange(side) / (2.0 * side) for side in (n + n % 2 for n in shape))
    octave = np.log2(np.maximum(np.hypot(rows[:, None], columns), 1e-9)).astype(np.float32)
    passed = [_ramp(octave + np.float32(np.log2(longest))) for longest, _ in bands]
    below = [*passed[1:], np.zeros_like(octave)]
    within = [above - finer for above, finer in zip(passed, below, strict=True)]
    return tuple(_long_waves(share) for share in (*within, 1.0 - passed[0]))


def _long_waves(share: ChannelPlane) -> ChannelPlane:
    """The corner of a share that is not 0, if it is a small one; else all of it."""
    rows, columns = np.max(np.nonzero(share), axis=1, initial=0) + 1
    few = max(rows / share.shape[0], columns / share.shape[1]) < _FEW
    return np.ascontiguousarray(share[:rows, :columns]) if few else share


def _of_waves(waves: NDArray[Any], share: ChannelPlane, shape: tuple[int, ...]) -> ChannelPlane:
    """The plane whose cosine transform is `share` of `waves`, without what was padded."""
    (down, across), (rows, columns), (height, width) = waves.shape, share.shape, shape
    if rows == down:
        return np.ascontiguousarray(cv2.idct(waves * share)[:height, :width])
    long = waves[:rows, :columns] * share
    whole = _cosines(down, rows)[:height] @ long @ _cosines(across, columns)[:width].T
    return np.asarray(whole, np.float32)


@lru_cache(maxsize=16)
def _cosines(side: int, count: int) -> ChannelPlane:
    """(side, count) the longest cosines of cv2.idct at `side` texels."""
    turns = np.arange(count) * (np.arange(side)[:, None] + 0.5) / (2.0 * side)
    waves = np.cos(2.0 * np.pi * turns) * np.sqrt(2.0 / side)
    waves[:, 0] = np.sqrt(1.0 / side)
    return np.asarray(waves, np.float32)


def _ramp(octave: ChannelPlane) -> ChannelPlane:
    """Smooth step from 0 to 1 at a border between bands; `octave` is log2 frequency over it."""
    return np.asarray(0.5 + 0.5 * np.sin(np.pi / 2 * (octave / _SOFT).clip(-1.0, 1.0)), np.float32)
