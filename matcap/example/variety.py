"""Choice of the variety (patch size): the highest one that keeps long structure.

Samples of the field are synthesised at several varieties, by rule 2 of placement, for which the
limits were found. Two measures are compared with limits: the loss of the exemplar's autocorrelation
at long shifts, and the share of texels at seams. Where none is within both, the least loss counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.candidates import PatchSizes, features_of, grid_bits, grids_of, planes_of
from matcap.example.coordinates import coordinates
from matcap.example.example import Example, coarsened, detail_bits
from matcap.example.index import Lookup
from matcap.example.placement import texture_trend
from matcap.example.plaid import detrended, is_plaid, repeating_plaid
from matcap.example.straighten import Planes, square_means
from matcap.field.plane import Rectangle

# Choice of the variety; docs/notes/field.md.
LOWEST_VARIETY = 0.1  # that is tried; also of a lattice that is straightened (fine_lattice.py)
_TRIED = (1.0, 0.5, 0.25, LOWEST_VARIETY)  # varieties, highest first
_LEVEL = 2  # level of the synthesised samples. Finer takes longer, coarser shows fewer seams.
_BLOCKS = 2  # samples of each variety; one where the exemplar has fewer levels
_STEP = 4  # texels that are averaged before the correlation
_NEAR = 64.0  # shortest shift of the correlation, texels; shorter structure fits any patch
_LOST = 0.035  # largest RMS loss of correlation
_SHARE = 0.5  # largest loss as a share of the exemplar's RMS correlation, if that is more
# Largest share of texels at seams. Textures without long structure have up to 0.0175, others
# from 0.021 on.
_SEAMS = 0.018
_MORE_SEAMS = 1.1  # largest share of seams over the least of all varieties, if that is more
_SQUARE = 4  # log2 of the texels of a square of the texture's trend
_FEWER = 0.9  # largest mean squared step of smaller patches over the largest ones', to be taken
_COMPARED = 7  # planes of features: all but the height, which its slopes describe


@dataclass(frozen=True)
class VarietyTrial:
    """Measures of one variety."""

    variety: float
    """Patch size, in [0, 1]."""
    lost: float
    """Loss of RMS correlation at long shifts, in [0, 1]."""
    seams: float
    """Share of texels at seams."""


def with_chosen_variety(example: Example) -> Example:
    """A copy of the example with the highest variety whose measures are within limits.

    If there is none, the limits are the least loss of all and about the least seams; of a lattice,
    whose seams do not follow the patches' size, see with_least_steps. A plaid repeats (plaid.py):
    of its bands no smaller patch shows where they go on.
    """
    if is_plaid(example):
        return repeating_plaid(example)
    long, trials = variety_trials(example)
    limit, tried = max(_LOST, _SHARE * long), []
    for one in trials:
        if one.lost <= limit and one.seams <= _SEAMS:
            return example.varied(one.variety)
        tried.append(one)
    if example.lookup.lattice is not None:
        return with_least_steps(example)
    limit = max(limit, min((one.lost for one in tried), default=0.0))
    seams = max(_SEAMS, _MORE_SEAMS * min((one.seams for one in tried), default=0.0))
    within = (one.variety for one in tried if one.lost <= limit and one.seams <= seams)
    return example.varied(next(within, LOWEST_VARIETY))


def with_least_steps(example: Example) -> Example:
    """A copy of the lowest variety, or of one whose texture steps less at seams.

    Large patches keep long threads. But a patch that is soft on one side, as of a tilted or blurred
    photograph, meets its neighbour's sharp one: where texture has a trend, patches are to be as
    small as the place that it leaves even. Compared is the mean square of the trend's steps.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    exemplar, count = example.exemplar, len(example.index.bases)
    coarse = coarsened(exemplar, detail_bits(exemplar))
    known = coarse.confidence.max(axis=0)
    rows, columns = (-(-side // (1 << _SQUARE)) for side in known.shape)
    seen = cv2.resize(known, (columns, rows), interpolation=cv2.INTER_AREA) > 0.0
    trend = texture_trend(planes_of(coarse), np.asarray(seen))
    level = min(_LEVEL, count - 1)
    area = Rectangle(0, 0, coarse.size[0] >> level, coarse.size[1] >> level)

    def steps(variety: float) -> float:
        places = coordinates(_varied(example.lookup, variety), 0, {level: area}, None)[level]
        seams = (np.diff(places, axis=1) != [1 << level, 0]).any(-1)
        shown = trend[:, places[..., 1] >> _SQUARE, places[..., 0] >> _SQUARE]
        return float((np.square(np.diff(shown, axis=2)) * seams).mean())

    *smaller, largest = ((steps(variety), variety) for variety in _TRIED)
    least = min(smaller)
    return example.varied((least if least[0] < _FEWER * largest[0] else largest)[1])


def variety_trials(example: Example) -> tuple[float, Iterator[VarietyTrial]]:
    """The exemplar's RMS correlation at long shifts, and measures of varieties, highest first."""
    exemplar, index = example.exemplar, example.index
    coarse = coarsened(exemplar, detail_bits(exemplar))
    level = min(_LEVEL, len(index.bases) - 1)
    features = features_of(planes_of(coarse), index.scale)
    planes = detrended(grids_of(features, level + 1)[level][:_COMPARED].astype(np.float32))
    lookup, spacing = example.lookup.of_rule_2(), 1 << level
    bits, side = grid_bits(level), max(1, _STEP // spacing)
    own = square_means(planes[:, :: spacing >> bits, :: spacing >> bits], side)
    true, shifts = _correlation(own)
    far = shifts >= _NEAR
    power = float((true[far] ** 2).mean()) if far.any() else 0.0
    if not power:
        return 0.0, iter(())

    def one(variety: float) -> VarietyTrial:
        kept, seams = _blocks(
            _varied(lookup, variety),
            level,
            coarse.size,
            lambda x, y: square_means(planes[:, y >> bits, x >> bits], side),
            true * far,
        )
        return VarietyTrial(variety, power**0.5 * (1.0 - kept), seams)

    return power**0.5, map(one, _TRIED)


def _blocks(
    lookup: Lookup,
    level: int,
    size: tuple[int, int],
    seen: Callable[[NDArray[np.int64], NDArray[np.int64]], Planes],
    true: NDArray[np.float64],
) -> tuple[float, float]:
    """Means over samples as large as the exemplar.

    Args:
        lookup: of the variety.
        level: of the samples.
        size: (width, height) of the exemplar.
        seen: features at places x, y of the exemplar.
        true: the exemplar's correlation, 0 at short shifts.

    Returns:
        Regression coefficient of the samples' correlation on the exemplar's, and share of seams.
    """
    spacing = 1 << level
    area = Rectangle(0, 0, -(-size[0] // spacing), -(-size[1] // spacing))
    kept, seams = [], []
    for seed in range(_BLOCKS if level == _LEVEL else 1):
        places = coordinates(lookup, seed, {level: area}, None)[level].astype(np.int64)
        correlation, _ = _correlation(seen(places[..., 0], places[..., 1]))
        rows, columns = (min(a, b) for a, b in zip(correlation.shape, true.shape, strict=True))
        wanted = true[:rows, :columns]
        kept.append(float((correlation[:rows, :columns] * wanted).sum() / (wanted**2).sum()))
        broken = (np.diff(places, axis=1) != [spacing, 0]).any(-1)
        seams.append(float(broken.mean()) / spacing)
    return float(np.mean(kept)), float(np.mean(seams))


def _varied(lookup: Lookup, variety: float) -> Lookup:
    coarsest = lookup.levels[-1]
    aspect = lookup.sizes.aspect
    sizes = PatchSizes.of(coarsest.frame, coarsest.spacing, lookup.lattice, variety, aspect)
    return lookup.sized(sizes)


def _correlation(planes: Planes) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normalised autocorrelation of planes (C, H, W), and the length of each shift in texels.

    Both (H / 2, W): shifts down by up to half the height, right or left by up to half the width.
    """
    rows, columns = planes.shape[1:]
    whole = (2 * rows, 2 * columns)
    centred = planes - planes.mean(axis=(1, 2), keepdims=True)
    power = (np.abs(np.fft.rfft2(centred, whole)) ** 2).sum(axis=0)
    overlap = np.abs(np.fft.rfft2(np.ones((rows, columns)), whole)) ** 2
    mean = np.fft.irfft2(power, whole) / np.maximum(np.fft.irfft2(overlap, whole), 1.0)
    down, across = np.arange(rows // 2), np.arange(-(columns // 2), columns // 2)
    half_plane = mean[np.ix_(down, across)] / max(float(mean[0, 0]), 1e-9)
    return half_plane, _STEP * np.hypot(down[:, None], across[None, :])
