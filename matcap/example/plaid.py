"""Plaids: bands across the whole exemplar, in both directions, which repeat whole.

The repeat of a plaid is longer than patches, and at most twice in a photograph, whose bands are
slanted. So its exemplar is made straight and periodic before it is indexed, and repeats.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from matcap.example.candidates import FRAME_MARGIN, MOST_LEVELS, grid_bits, level_count
from matcap.example.example import Example, detail_bits, halvings, known_part
from matcap.example.exemplar import DIFFUSE, Exemplar, Floats
from matcap.example.repeat import cut_and_joined
from matcap.example.straighten import Planes, likest_shift, sheared, square_means

_BLOCKS_ACROSS = 64  # of a plaid, across the longer side
# Least share of log albedo's variance that bands of a plaid have in either direction (three of 126
# photographs 0.16 to 0.24, other weaves at most 0.12, a cloth of uneven threads 0.00), and its
# least standard deviation (plaids 0.20, paint 0.05).
_BANDS, _VISIBLE = 0.14, 0.1
_DARKEST = 1e-3  # albedo, lower limit of its logarithm
_LEAST = 0.35  # least share of a side that the repeat of the bands has
_OVERLAP = 8  # texels, least overlap of copies a repeat apart
_THREADS = 2.0  # texels, standard deviation of the blur before bands are compared
_RIDGE = 1e-3  # of the mean square of a term, that keeps what the drift leaves open small


def is_plaid(example: Example) -> bool:
    """Whether much of the albedo is bands across the whole exemplar, in both directions.

    Log albedo of blocks is a(x) + b(y) + rest; the covariance of neighbouring blocks of a, and that
    of b, is at least _BANDS of its variance: single threads are narrower. A lattice of cells as
    large as blocks (gingham, tiles) is kept in phase instead.
    """
    albedo, lattice = _shown(example)[DIFFUSE], example.index.lattice
    waves = () if lattice is None else lattice.waves
    side = max(2, max(albedo.shape) // _BLOCKS_ACROSS)
    rows, columns = (n // side for n in albedo.shape[1:])
    cell = max((2 ** detail_bits(example.exemplar) / math.hypot(*w) for w in waves), default=0.0)
    if min(rows, columns) < 8 or cell > 2 * side:
        return False
    means = detrended(square_means(_log(albedo), side))
    whole = float(np.square(means).mean())
    bands = [float((band[:, 1:] * band[:, :-1]).mean()) for band in (means.mean(1), means.mean(2))]
    return whole > _VISIBLE**2 and min(bands) > _BANDS * whole


def repeating_plaid(example: Example) -> Example:
    """A plaid's exemplar made straight and periodic, which repeats whole.

    What it is indexed from has the margin that places keep from borders (frame_of), periodically
    continued, so that the frame whose opposite borders adjoin (Lookup.joined) is the repeat. Where
    straight maps are hardly longer than that, the exemplar repeats as it is.
    """
    exemplar, maps = example.exemplar, _shown(example)
    bands = _bands(maps[DIFFUSE])
    across, (under, right) = (
        likest_shift(planes, _LEAST)
        for planes in (bands, np.ascontiguousarray(bands.transpose(0, 2, 1)))
    )
    straight, along, below = sheared(maps, across, (right, under), example.alignment)
    if straight.shape[2] < along + _OVERLAP or straight.shape[1] < below + _OVERLAP:
        return example.varied(0.0)
    even = straight.copy()
    even[DIFFUSE] *= np.exp(-_drift(_log(straight[DIFFUSE]), along, below))
    np.clip(even[:-1], 0.0, 1.0, out=even[:-1])
    tile, _ = cut_and_joined(even, exemplar.texel_size, along, below)
    repeat, one_light = _continued(tile, exemplar.texel_size), example.index.rule > 1
    return Example.of_rounded(repeat, one_light=one_light).varied(0.0)


def _shown(example: Example) -> Floats:
    """(6 or 8, h, w) stacked maps of the part that fields show."""
    exemplar, bits, part = example.exemplar, detail_bits(example.exemplar), example.index.part
    box = known_part(exemplar, 1 << bits, part and part.enlarged(bits))
    rows, columns = slice(box.y, box.y + box.height), slice(box.x, box.x + box.width)
    return exemplar.stacked()[:, rows, columns]


def _bands(albedo: Floats) -> Planes:
    """Log albedo without threads and drift, in standard deviations."""
    import cv2  # takes a tenth of a second, which synthesis is spared

    log = np.stack([cv2.GaussianBlur(plane, (0, 0), _THREADS) for plane in _log(albedo)])
    even = detrended(log)
    return np.asarray(even / max(float(even.std()), 1e-6), np.float32)


def _drift(log: Floats, along: int, below: int) -> Floats:
    """(C, H, W) slow drift of log albedo, an error of the light's fit: a quadratic q of place.

    Bands a repeat apart are alike, so that log(p + s) - log(p) = q(p + s) - q(p) for both repeats
    s, in the mean over squares.
    """
    side = 1 << max(0, math.ceil(math.log2(max(log.shape) / _BLOCKS_ACROSS)))
    means, terms = square_means(log, side), square_means(_quadratic(log.shape[1:])[1:], side)
    known: list[NDArray[np.floating]] = []
    wanted: list[NDArray[np.floating]] = []
    for shift, axis in ((round(along / side), 2), (round(below / side), 1)):
        ahead, behind = (slice(shift, None), slice(None, -shift))
        for planes, into in ((terms, known), (means, wanted)):
            moved = planes.swapaxes(axis, 2)
            into.append((moved[:, :, ahead] - moved[:, :, behind]).reshape(len(planes), -1))
    steps, rises = np.concatenate(known, axis=1), np.concatenate(wanted, axis=1)
    gram = steps @ steps.T
    if not gram.any():  # overlaps narrower than a square
        return np.zeros_like(log)
    ridge = _RIDGE * float(np.trace(gram)) / len(gram) * np.eye(len(gram))
    amounts = np.linalg.solve(gram + ridge, steps @ rises.T)
    drift = np.einsum("tc,thw->chw", amounts, _quadratic(log.shape[1:])[1:])
    return np.asarray(drift - drift.mean(axis=(1, 2), keepdims=True), np.float32)


def _continued(tile: Floats, texel_size: float) -> Exemplar:
    """A tile with the margin of the frame of places around it, rounded as in a file."""
    before, after = _margins(tile.shape[2], tile.shape[1])
    rows, columns = (np.arange(-before, side + after) % side for side in tile.shape[1:])
    return Exemplar.certain(tile[:, rows[:, None], columns], texel_size).rounded()


def _margins(wide: int, high: int) -> tuple[int, int]:
    """Texels before and after a tile's sides with which its frame is it, and a line more, with
    which its first line is compared.
    """
    before = after = 0
    # Fewer levels need less, as many as a larger exemplar has.
    for bits in range(halvings(max(wide, high)) + 2):
        for levels in range(1, MOST_LEVELS + 1):
            before = FRAME_MARGIN << levels - 1 + bits
            after = before + (1 << grid_bits(levels - 1) + bits)
            sides = [side + before + after for side in (wide, high)]
            if halvings(max(sides)) == bits and level_count(*(n >> bits for n in sides)) == levels:
                return before, after
    return before, after


def detrended(planes: Planes) -> Planes:
    """Planes less their least-squares quadratic, which is an error of the light's fit."""
    basis = np.linalg.qr(_quadratic(planes.shape[1:]).reshape(6, -1).T)[0].astype(np.float32)
    flat = planes.reshape(len(planes), -1)
    return np.asarray((flat - (flat @ basis) @ basis.T).reshape(planes.shape), np.float32)


def _quadratic(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """(6, H, W) monomials of place up to the second degree, the constant first."""
    y, x = np.mgrid[-0.5 : 0.5 : shape[0] * 1j, -0.5 : 0.5 : shape[1] * 1j]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def _log(albedo: Floats) -> Floats:
    return np.log(np.maximum(albedo, _DARKEST))
