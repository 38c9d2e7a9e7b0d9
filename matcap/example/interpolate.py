"""An exemplar between two exemplars: laid over each other, and interpolated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.brdf.heights import resized_height
from matcap.example.blend import ExemplarBands, Votes, bands_of, blended, seam_correlations
from matcap.example.exemplar import CHANNELS, COLOURED, DIFFUSE, HEIGHT, SPECULAR, Exemplar, Floats
from matcap.field.plane import Rectangle
from matcap.files.color import LUMINANCE

# Two exemplars laid over each other: for every texel of a grid, a place of either.
#
# Patches of both that look alike are laid on each other, so that their mean has edges where both
# have them, as in patch-based texture interpolation [ruiters2010]. What is compared is an
# exemplar's *pattern*
#
# d = log(Y) + F^-1(2 pi |f| F(h)),
#
# with Y the luminance of diffuse albedo and F0 and h the height in texels: radiance under oblique
# light varies by about as much as by the slope, so that a crease compares with a dark grain.
# Octaves of both patterns are scaled to the geometric mean of their deviations, and values mapped
# by rank to a normal distribution.
#
# At the share t, with D_i the patterns, places p_i alternate, coarse to fine, between
#
# Y = (1 - t) D_1 o p_1 + t D_2 o p_2 + h ((1 - t) D_1 + t D_2),
# p_i(x) = argmin_p |N(D_i, p) - N(Y, x)|^2,
#
# as in texture optimisation [kwatra2005] with two examples. N is a neighbourhood of 5 x 5,
# projected on its principal components, Y is scaled to the deviation of D_i, and h decreases from
# level to level. Near t = 0 the first keeps its places, and the second follows it.
#
# The search is PatchMatch's [barnes2009], with random numbers from one seed, in floating point:
# results are the same again on one machine, not to the bit on all.

OCTAVES = 6  # finest of about 4 texels, coarsest of about 128; slower drifts are no pattern
# Steps of the search. Twice as many take half as long again and change nothing to the eye.
_COARSEST = 32  # texels along the long side of the coarsest level
_LARGEST = 1024  # texels along it above which places are only upsampled
_ALTERNATIONS = (6, 4, 3, 2)  # of the first and the second, by level from the coarsest
_INITIAL = (1.0, 0.6, 0.3, 0.0)  # h, likewise
_ROUNDS = 2  # of propagation in an alternation, one at the two finest levels
_FIRST_ROUNDS = 6  # at the coarsest level, before the alternations
_COHERENT = 1.5  # factor on the cost of random candidates, which break patches up
_RADIUS = 2  # of a neighbourhood
_FALL_OFF = 1.6  # standard deviation of its weights, texels
_DIMENSIONS = 12  # principal components of neighbourhoods
_SAMPLES = 8000  # neighbourhoods of each pattern that these are computed from
_DARKEST = 0.02  # added to luminance before the logarithm
_INVISIBLE = 0.01  # added to an octave's deviation, so that what is invisible is not amplified
_RANKS = 1024

Coordinates = NDArray[np.int64]  # (H, W, 2) x, y


@dataclass(frozen=True)
class Overlay:
    """Places of two exemplars on one grid, (H, W, 2) x, y in texels of each."""

    first: Coordinates
    second: Coordinates


def overlay(first: Exemplar, second: Exemplar, share: float, size: tuple[int, int]) -> Overlay:
    """Lay two exemplars over each other.

    Args:
        first, second: of the same texel size.
        share: of the second, between 0 and 1.
        size: (width, height) of the grid.
    """
    patterns = patterns_of(first, second)
    count = max(1, round(math.log2(max(size) / _COARSEST)) + 1)
    pyramids = [[pattern] for pattern in patterns]
    for pyramid in pyramids:
        while len(pyramid) < count and min(pyramid[-1].shape) > 4 * _RADIUS:
            rows, columns = (side // 2 for side in pyramid[-1].shape)
            pyramid.append(np.asarray(cv2.pyrDown(pyramid[-1])[:rows, :columns], np.float32))
    count = min(len(pyramid) for pyramid in pyramids)
    random = np.random.default_rng(0)
    laid: tuple[Coordinates, ...] = ()
    for level in reversed(range(count)):
        one, other = (pyramid[level] for pyramid in pyramids)
        rows, columns = size[1] >> level, size[0] >> level
        step = _OverlayLevel(one, other, share, (rows, columns), count - 1 - level, random)
        laid = step.refined(laid, fine=level < 2)
    return Overlay(*laid)


def patterns_of(first: Exemplar, second: Exemplar) -> tuple[Floats, Floats]:
    """The patterns of both, of equal spectrum and distribution; see the module's equations."""
    pairs = [octaves(pattern_of(exemplar)) for exemplar in (first, second)]
    deviations = [[float(octave.std()) + _INVISIBLE for octave in pair] for pair in pairs]
    wanted = [math.sqrt(one * other) for one, other in zip(*deviations, strict=True)]
    patterns: list[Floats] = []
    for pair, own in zip(pairs, deviations, strict=True):
        gains = np.array(wanted, np.float32) / np.array(own, np.float32)
        patterns.append(_normal(np.einsum("o,ohw->hw", gains, np.stack(pair))))
    return patterns[0], patterns[1]


def octaves(plane: Floats) -> list[Floats]:
    """OCTAVES differences of Gaussians, finest first; the plane less their sum is its drift."""
    split = []
    for octave in range(OCTAVES):
        blurred = cv2.GaussianBlur(plane, (0, 0), 1.4 * 2**octave, borderType=cv2.BORDER_REFLECT)
        smooth = np.asarray(blurred, np.float32)
        split.append(plane - smooth)
        plane = smooth
    return split


def lerp(first: Floats, second: Floats, share: float) -> Floats:
    """Linear interpolation in float32."""
    return np.float32(1.0 - share) * first + np.float32(share) * second


def _mirrored(length: int, count: int) -> NDArray[np.int64]:
    """`count` indices of an axis of `length`, back and forth."""
    turn = np.arange(count) % (2 * length)
    return np.minimum(turn, 2 * length - 1 - turn)


def pattern_of(exemplar: Exemplar) -> Floats:
    """(H, W) pattern of an exemplar; see the module's equation."""
    colour = exemplar.diffuse + exemplar.specular if exemplar.coloured else exemplar.diffuse
    luminance = np.tensordot(np.array(LUMINANCE, np.float32), colour, 1)
    height = exemplar.height[0] / np.float32(exemplar.texel_size)
    rows, columns = height.shape
    around = np.pad(height, ((0, rows), (0, columns)), mode="symmetric")  # periodic
    across, down = np.fft.rfftfreq(2 * columns), np.fft.fftfreq(2 * rows)[:, None]
    spectrum = np.fft.rfft2(around) * (2.0 * np.pi * np.hypot(across, down))
    relief = np.fft.irfft2(spectrum, s=around.shape)[:rows, :columns]
    return np.asarray(np.log(luminance + _DARKEST) + relief, np.float32)


def _normal(values: Floats) -> Floats:
    """Map values by rank to a normal distribution of deviation 1."""
    shares = (np.arange(_RANKS) + 0.5) / _RANKS
    quantiles = [NormalDist().inv_cdf(float(share)) for share in shares]
    return by_rank(values, shares, np.array(quantiles))


def by_rank(values: Floats, shares: NDArray[np.float64], quantiles: NDArray[np.float64]) -> Floats:
    """Map values by rank to a distribution, given by its quantiles at increasing shares."""
    mapped = np.empty(values.size, np.float32)
    ranks = (np.arange(values.size) + 0.5) / values.size
    mapped[np.argsort(values, axis=None, kind="stable")] = np.interp(ranks, shares, quantiles)
    return mapped.reshape(values.shape)


class _OverlayLevel:
    """One level of the pyramids: patterns, and the places of both on the level's grid."""

    def __init__(
        self,
        first: Floats,
        second: Floats,
        share: float,
        shape: tuple[int, int],
        depth: int,
        random: np.random.Generator,
    ) -> None:
        """Prepare a level; `depth` counts from the coarsest, `shape` is the grid's."""
        self.patterns, self.share, self.shape, self.random = (first, second), share, shape, random
        self.initial = _INITIAL[min(depth, len(_INITIAL) - 1)]
        self.alternations = _ALTERNATIONS[min(depth, len(_ALTERNATIONS) - 1)]
        if max(shape) > _LARGEST:
            self.alternations = 0
            return
        self.basis = _principal(first, second)
        self.known = [_neighbourhoods(pattern, self.basis) for pattern in self.patterns]
        one, other = (pattern[np.ix_(*self._axes(pattern))] for pattern in self.patterns)
        self.mixed = lerp(one, other, share)

    def refined(self, coarse: tuple[Coordinates, ...], *, fine: bool) -> tuple[Coordinates, ...]:
        """Places of this level, from the coarser level's or none."""
        if coarse:
            laid = [
                _doubled(places, self.shape, pattern)
                for places, pattern in zip(coarse, self.patterns, strict=True)
            ]
        else:
            laid = [self._begun(side) for side in (0, 1)]
        for number in range(self.alternations):
            for side in (1, 0):
                first, second = (
                    pattern[places[..., 1], places[..., 0]]
                    for pattern, places in zip(self.patterns, laid, strict=True)
                )
                laid[side] = self._search(
                    side,
                    lerp(first, second, self.share) + np.float32(self.initial) * self.mixed,
                    laid[side],
                    rounds=1 if fine else _ROUNDS,
                    widely=not fine or number == 0,
                )
        return tuple(laid)

    def _axes(self, pattern: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        rows, columns = self.shape
        return _mirrored(pattern.shape[0], rows), _mirrored(pattern.shape[1], columns)

    def _begun(self, side: int) -> Coordinates:
        """Places by which a pattern follows the mean of both, from the undisturbed ones."""
        down, across = self._axes(self.patterns[side])
        places = np.stack(np.meshgrid(across, down), axis=-1)
        return self._search(side, self.mixed, places, rounds=_FIRST_ROUNDS, widely=True)

    def _search(
        self, side: int, target: Floats, places: Coordinates, *, rounds: int, widely: bool
    ) -> Coordinates:
        """Better places of a pattern for a target, by neighbours' and by random candidates."""
        pattern, known = self.patterns[side], self.known[side]
        scaled = (target - target.mean()) * (pattern.std() / (target.std() + 1e-6))
        wanted = _neighbourhoods(scaled + pattern.mean(), self.basis)
        most = np.array(pattern.shape[::-1]) - 1
        flat = known.reshape(-1, _DIMENSIONS)

        def cost(candidates: Coordinates) -> Floats:
            other = flat[candidates[..., 1] * known.shape[1] + candidates[..., 0]]
            difference = other - wanted
            return np.einsum("hwd,hwd->hw", difference, difference)

        places = places.copy()
        best = cost(places)

        def attempt(candidates: Coordinates, factor: float) -> None:
            inside = candidates.clip(0, most)
            costs = np.float32(factor) * cost(inside)
            better = (costs < best) & (inside == candidates).all(axis=-1)
            places[better], best[better] = inside[better], costs[better]

        for _ in range(rounds):
            for offset in ((1, 0), (0, 1), (-1, 0), (0, -1)):
                attempt(np.roll(places, offset[::-1], (0, 1)) + np.array(offset), 1.0)
            reach = max(pattern.shape) if widely else 0
            while reach:
                jumps = self.random.integers(-reach, reach + 1, places.shape)
                attempt((places + jumps).clip(0, most), _COHERENT)
                reach //= 3
        return places


def _doubled(coarse: Coordinates, shape: tuple[int, int], pattern: Floats) -> Coordinates:
    """Places of a grid twice as fine: each coarse one gives four."""
    rows, columns = shape
    down, across = (
        np.minimum(np.arange(count) // 2, of - 1)
        for count, of in zip(shape, coarse.shape[:2], strict=True)
    )
    odd = np.stack(np.meshgrid(np.arange(columns) & 1, np.arange(rows) & 1), axis=-1)
    most = np.array(pattern.shape[::-1]) - 1
    return (2 * coarse[np.ix_(down, across)] + odd).clip(0, most)


def _principal(first: Floats, second: Floats) -> Floats:
    """(_DIMENSIONS, taps) principal components of both patterns' neighbourhoods."""
    samples = np.concatenate(
        [_taps(pattern)[:, :: max(1, pattern.size // _SAMPLES)] for pattern in (first, second)],
        axis=1,
    )
    samples = samples - samples.mean(axis=1, keepdims=True)
    _, components = np.linalg.eigh(samples @ samples.T)
    return np.ascontiguousarray(components[:, : -_DIMENSIONS - 1 : -1].T, np.float32)


def _neighbourhoods(pattern: Floats, basis: Floats) -> Floats:
    """(H, W, _DIMENSIONS) neighbourhoods of a pattern, mirrored at its borders."""
    projected = np.ascontiguousarray((basis @ _taps(pattern)).T)
    return projected.reshape(*pattern.shape, _DIMENSIONS)


def _taps(pattern: Floats) -> Floats:
    """(taps, H * W) weighted texels of all neighbourhoods."""
    rows, columns = pattern.shape
    around = np.pad(pattern, _RADIUS, mode="symmetric")
    side = range(2 * _RADIUS + 1)
    return np.stack([
        around[y : y + rows, x : x + columns].ravel()
        * np.float32(math.exp(-((y - _RADIUS) ** 2 + (x - _RADIUS) ** 2) / (2 * _FALL_OFF**2)))
        for y in side
        for x in side
    ])  # fmt: skip


# An exemplar between two exemplars: their maps laid over each other, and interpolated by octave.
#
# Places of both (interpolate.py) give two sets of maps on one grid, blended at seams (blend.py).
# Diffuse albedo and F0 are interpolated as square roots, which is about even to the eye; roughness
# and height, in texels, as they are. With B_1k, B_2k the octaves of a map's plane at the share t,
#
# B_k = g_k ((1 - t) B_1k + t B_2k),    log s(B_k) = (1 - t) log s_1k + t log s_2k,
#
# g_k restoring the deviations s that the exemplars' own octaves have: the mean of two different
# textures alone would lose contrast. Means and drifts are interpolated. Values of all maps but
# height are then mapped by rank to the distribution of interpolated quantiles. Slopes follow from
# height.
#
# F0 of a dielectric and of a metal are interpolated like any others, and diffuse albedo too, so
# that it fades as F0 rises and their sum stays within 1: a dull sheen half-way.

_UNSEEN = 0.003  # deviation of an octave that is not visible; roots of albedo, roughness, texels
_QUANTILES = np.linspace(0.0, 1.0, 513)
_BEYOND = 96  # texels beyond the grid that nodes of the coarsest band read; a multiple of 8
_LEVELS = 5  # of places: as many as blend.py reads
_MEASURED = 128  # texels a side of the part whose seams are measured


def interpolated(first: Exemplar, second: Exemplar, share: float) -> Exemplar:
    """An exemplar between two; shares 0 and 1 return the given ones.

    It has the size in plane units of the nearer one, and a texel size interpolated as a logarithm.
    Its confidence is the geometric mean of both, weighted by the shares.

    Args:
        first, second: of at least 14 texels a side.
        share: of the second, in [0, 1].
    """
    if share in (0.0, 1.0):
        return second if share else first
    texel = first.texel_size ** (1.0 - share) * second.texel_size**share
    ends = [_resampled(end, texel) for end in (first, second)]
    if ends[0].coloured != ends[1].coloured:
        ends = [_coloured(end) for end in ends]
    laid = overlay(ends[0], ends[1], share, ends[round(share)].size)
    shown = [
        _roots(_shown(end, places), texel)
        for end, places in zip(ends, (laid.first, laid.second), strict=True)
    ]
    own = [_roots(end.stacked(), texel) for end in ends]
    maps = np.stack([
        _plane_between((shown[0][plane], shown[1][plane]), (own[0][plane], own[1][plane]), share,
                 ranked=plane < len(own[0]) - 1)
        for plane in range(len(own[0]))
    ])  # fmt: skip
    confidence = [
        end.confidence[:, places[..., 1], places[..., 0]]
        for end, places in zip(ends, (laid.first, laid.second), strict=True)
    ]
    return Exemplar(
        diffuse=np.square(maps[DIFFUSE].clip(0.0, 1.0)),
        specular=np.square(maps[SPECULAR].clip(0.0, 1.0)),
        roughness=maps[-2:-1].clip(0.0, 1.0),
        height=maps[HEIGHT] * np.float32(texel),
        confidence=np.power(confidence[0], 1.0 - share) * np.power(confidence[1], share),
        texel_size=texel,
    )


def _resampled(exemplar: Exemplar, texel_size: float) -> Exemplar:
    """An exemplar resampled to another texel size."""
    scale = exemplar.texel_size / texel_size
    width, height = (max(1, round(side * scale)) for side in exemplar.size)
    size = width, height
    if size == exemplar.size:
        return replace(exemplar, texel_size=texel_size)
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    resized = {
        name: np.stack([cv2.resize(p, size, interpolation=how) for p in getattr(exemplar, name)])
        for name in (*CHANNELS, "confidence")
        if name != "height"
    }
    for plane in resized.values():
        plane.clip(0.0, 1.0, out=plane)  # weights are rounded
    resized["height"] = resized_height(exemplar.height[0], size)[None]
    return replace(exemplar, **resized, texel_size=texel_size)


def _coloured(exemplar: Exemplar) -> Exemplar:
    channels = COLOURED // len(exemplar.specular)
    return replace(exemplar, specular=exemplar.specular.repeat(channels, axis=0))


def _roots(stacked: Floats, texel_size: float) -> Floats:
    """Stacked maps as they are interpolated: square roots of albedo and F0, height in texels."""
    roots = stacked.copy()
    roots[DIFFUSE], roots[SPECULAR] = np.sqrt(roots[DIFFUSE]), np.sqrt(roots[SPECULAR])
    roots[HEIGHT] /= np.float32(texel_size)
    return roots


def _shown(exemplar: Exemplar, places: Coordinates) -> Floats:
    """(6 or 8, H, W) stacked maps of an exemplar at places, blended at seams."""
    rows, columns = places.shape[:2]
    area, bands = Rectangle(0, 0, columns, rows), bands_of(exemplar)
    down, across = (np.arange(-_BEYOND, side + _BEYOND) for side in (rows, columns))
    inside = down.clip(0, rows - 1), across.clip(0, columns - 1)
    # Beyond the grid, places go on as at its border.
    around = places[np.ix_(*inside)]
    around[..., 0] += across - inside[1]
    around[..., 1] += (down - inside[0])[:, None]
    around = around.clip(0, np.array(exemplar.size) - 1).astype(np.int16)
    votes = []
    for band in range(len(bands)):
        vote = Votes.of(band, area, None, 0, _LEVELS)
        step, wanted = 1 << vote.level, vote.wanted
        y, x = (
            (np.arange(start, start + count) * step + _BEYOND).clip(0, len(axis) - 1)
            for start, count, axis in (
                (wanted.y, wanted.height, down), (wanted.x, wanted.width, across),
            )
        )  # fmt: skip
        votes.append((vote, vote.predicted(around[np.ix_(y, x)], area)))
    own = around[_BEYOND : _BEYOND + rows, _BEYOND : _BEYOND + columns]
    correlations = seam_correlations(bands, own[:_MEASURED, :_MEASURED], 1)
    planes = tuple(plane for name in CHANNELS for plane in getattr(exemplar, name))
    return blended(ExemplarBands(planes, bands, correlations, 0), area, own, votes)


def _plane_between(
    shown: tuple[Floats, Floats], own: tuple[Floats, Floats], share: float, *, ranked: bool
) -> Floats:
    """Interpolate a plane; see the module's equations.

    Args:
        shown: (H, W) of both on the common grid.
        own: (H, W) of the exemplars themselves.
        share: of the second.
        ranked: interpolate quantiles too.
    """
    first, second = (octaves(plane) for plane in shown)
    deviations = [[float(octave.std()) for octave in octaves(plane)] for plane in own]
    drift = lerp(shown[0] - np.sum(first, axis=0), shown[1] - np.sum(second, axis=0), share)
    means = [float(plane.mean()) for plane in own]
    mixed = drift - drift.mean() + np.float32((1.0 - share) * means[0] + share * means[1])
    for one, other, *wanted in zip(first, second, *deviations, strict=True):
        octave = lerp(one, other, share)
        logs = [math.log(deviation + _UNSEEN) for deviation in wanted]
        deviation = math.exp((1.0 - share) * logs[0] + share * logs[1]) - _UNSEEN
        mixed += octave * np.float32(deviation / (float(octave.std()) + 1e-6))
    if not ranked:
        return mixed
    quantiles = [np.quantile(plane, _QUANTILES) for plane in own]
    return by_rank(mixed, _QUANTILES, (1.0 - share) * quantiles[0] + share * quantiles[1])
