"""Sensor noise: estimated from the mosaic, and sampled.

Shot and read noise give a photosite the variance shot * signal + read [foi2008]. Noise is
independent between photosites, while a lens blurs the image. The response to a checkerboard of
single photosites is therefore mostly noise, and in the smoothest blocks entirely.

Captures need it because noise resembles texture: the same noise is added to renderings before they
are compared with the photograph (space/tuning/finetune.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Mixed second difference [immerkaer1996]: 0 for images that are linear along x or y, of unit gain
# for noise.
_CHECKER = np.outer((1.0, -2.0, 1.0), (1.0, -2.0, 1.0)).astype(np.float32) / 6.0
_SMOOTH = 1.5  # standard deviation of the signal's blur, photosites of one colour
_BLOCK = 16  # photosites a side of a block, in which variance is measured
_TILE = 256  # photosites a side of a tile
_TILES = 48  # most tiles that are used
_BINS, _BLOCKS_IN_BIN = 16, 20  # most bins by signal, and least blocks in a bin
_PLAIN = 0.1  # quantile of the variance over a bin's blocks, which are taken as textureless
# That quantile in a flat field, as a share of the noise's variance.
_FLAT_FIELD = 0.69
_AGREES = 1.05  # ratio to the line above which a bin's variance includes texture
_LEAST_BINS = 4  # for the line's fit
_ROUNDING = 1 / 12  # variance of rounding to integers
_DARKEST = 1 / 500  # lower limit of the signal, share of the white level
_STRIP_PHOTOSITES = 1 << 20  # processed at once


@dataclass(frozen=True)
class SensorNoise:
    """Noise model: variance = shot * signal + read, of the file's values above black."""

    shot: float
    """Variance over signal, the value of one photon."""
    read: float
    """Variance at signal 0."""

    def added(
        self, mosaic: NDArray[np.uint16], black: NDArray[np.float64], seed: int
    ) -> NDArray[np.uint16]:
        """The mosaic (H, W) with a sample of the noise added; `black` as in find_noise."""
        generator = np.random.default_rng(seed)
        result = np.empty_like(mosaic)
        step = max(2, _STRIP_PHOTOSITES // mosaic.shape[1] // 2 * 2)
        for top in range(0, len(mosaic), step):
            stored = mosaic[top : top + step].astype(np.float32)
            signal = np.maximum(stored - _tiled(black, stored.shape), 0.0)
            stored += np.sqrt(self.shot * signal + self.read) * generator.standard_normal(
                stored.shape, np.float32
            )
            result[top : top + step] = np.rint(stored).clip(0, np.iinfo(np.uint16).max)
        return result


def find_noise(
    mosaic: NDArray[np.uint16], black: NDArray[np.float64], white: float
) -> SensorNoise | None:
    """Estimate the noise of a Bayer mosaic; an upper bound if all of it has the finest texture.

    Args:
        mosaic: (H, W) stored values.
        black: (2, 2) black level by position in the pattern.
        white: saturation level.

    Returns:
        The noise model; None if too few blocks are well exposed.
    """
    pieces = [_measured(tile, black, white) for tile in _tiles(mosaic)]
    variance, shot, read = np.concatenate(pieces, axis=1) if pieces else np.empty((3, 0))
    bins = min(_BINS, variance.size // _BLOCKS_IN_BIN)
    if bins == 0:
        return None
    # A block's effective signal, dominated by its darker photosites.
    signal = shot / read
    order = np.argsort(signal)
    edges = np.linspace(0, order.size, bins + 1).astype(int)
    points = []
    for first, last in pairwise(edges):
        at = order[first:last]
        plainest = np.quantile(variance[at] / shot[at], _PLAIN) / _FLAT_FIELD
        points.append((signal[at].mean(), max(plainest * signal[at].mean(), _ROUNDING)))
    return _lower_line(np.array(points))


def _tiles(mosaic: NDArray[np.uint16]) -> list[NDArray[np.uint16]]:
    """At most _TILES tiles, evenly spread, aligned with the pattern."""
    height, width = (side // 2 * 2 for side in mosaic.shape)
    rows, columns = (max(1, side // _TILE) for side in (height, width))
    places = [(row, column) for row in range(rows) for column in range(columns)]
    every = -(-len(places) // _TILES)
    tall, wide = min(_TILE, height), min(_TILE, width)
    return [
        mosaic[row * _TILE : row * _TILE + tall, column * _TILE : column * _TILE + wide]
        for row, column in places[::every]
    ]


def _measured(
    tile: NDArray[np.uint16], black: NDArray[np.float64], white: float
) -> NDArray[np.float64]:
    """(3, blocks) relative variance, and its value for shot noise of 1 and for read noise of 1."""
    import cv2

    numbers = tile.astype(np.float32)
    signal = numbers - _tiled(black, tile.shape)
    smooth = np.empty_like(signal)
    for row in (0, 1):
        for column in (0, 1):
            sites = np.s_[row::2, column::2]
            smooth[sites] = cv2.GaussianBlur(signal[sites], (0, 0), _SMOOTH)
    smooth = np.maximum(smooth, np.float32(_DARKEST * (white - black.max())))
    checker = cv2.filter2D(signal / smooth, -1, _CHECKER)
    shot, read = (cv2.filter2D(smooth**-power, -1, _CHECKER**2) for power in (1, 2))
    saturated = cv2.dilate((numbers >= 0.97 * white).astype(np.float32), np.ones((9, 9)))
    usable = _blocks(saturated) == 0.0
    return np.stack([_blocks(checker**2)[usable], _blocks(shot)[usable], _blocks(read)[usable]])


def _blocks(picture: NDArray[Any]) -> NDArray[np.float64]:
    """(blocks,) means of whole blocks."""
    height, width = (side // _BLOCK for side in picture.shape)
    whole = picture[: height * _BLOCK, : width * _BLOCK]
    shaped = whole.reshape(height, _BLOCK, width, _BLOCK)
    return np.asarray(shaped.mean(axis=(1, 3), dtype=np.float64)).ravel()


def _lower_line(points: NDArray[np.float64]) -> SensorNoise:
    """Fit the line to (signal, variance) points, dropping those above it, which include texture."""
    signal, variance = points.T
    kept = np.ones(len(points), bool)
    while True:
        line = _line(signal[kept], variance[kept])
        above = variance / (line.shot * signal + line.read)
        allowed = max(_AGREES, np.sort(above)[min(_LEAST_BINS, len(above)) - 1])
        remaining = kept & (above <= allowed)
        if remaining.sum() == kept.sum() or not remaining.any():
            return line
        kept = remaining


def _line(signal: NDArray[np.float64], variance: NDArray[np.float64]) -> SensorNoise:
    """Least-squares line in relative errors, with non-negative shot and read noise."""
    terms = np.stack([signal, np.ones_like(signal)], axis=1) / variance[:, None]
    ones = np.ones_like(signal)
    if len(signal) > 1:
        shot, read = np.linalg.lstsq(terms, ones)[0]
        if shot >= 0.0 and read >= 0.0:
            return SensorNoise(float(shot), float(read))
    alone = terms.sum(axis=0) / np.square(terms).sum(axis=0)
    worse = np.square(terms * alone - ones[:, None]).sum(axis=0)
    if worse[0] <= worse[1]:
        return SensorNoise(float(alone[0]), 0.0)
    return SensorNoise(0.0, float(alone[1]))


def _tiled(black: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """(H, W) black levels, by repeating the pattern."""
    rows, columns = np.arange(shape[0])[:, None] % 2, np.arange(shape[1])[None, :] % 2
    return black.astype(np.float32)[rows, columns]
