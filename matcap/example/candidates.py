"""Appearance vectors [lefebvre2006], k-coherence candidates [tong2002] and grids of an exemplar."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import Exemplar
from matcap.example.lattice import LEAST_PATCH, PhasedLattice
from matcap.example.library import address, draw, hash_places, loops
from matcap.files.color import LUMINANCE

# Features by which places of an exemplar are compared: its maps quantised to small integers.
#
# Elementwise arithmetic without rounding differences: an exemplar and a Scale give the same
# features on every machine.
#
# Eight planes: square roots of diffuse albedo (3) and of F0 (1), roughness, slopes of the height
# along x and y, and height. The square root makes steps perceptually about even. Where F0 has a
# colour, the first three are square roots of diffuse albedo plus F0, and the fourth of F0's
# luminance: metals have their colour in F0, dielectrics in the albedo, so that four planes
# distinguish both.

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
SLOPES = slice(5, 7)  # planes of the slopes along x and down
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


# Appearance vectors: PCA of texel neighbourhoods [lefebvre2006], in integers.
#
# Neighbourhoods of 5 x 5 features, with Gaussian weights, are projected on their principal
# components. Basis and features are integers of 7 bits plus sign, so that sums are integers below
# 2^24, exact whatever their order.

_FALL_OFF = 8.0  # f of the neighbourhood's weights exp(-r^2 / f), in squared steps
_SAMPLES = 20_000  # neighbourhoods that the PCA is computed from
_CLIPPED = 0.002  # share of places whose first component exceeds appearance.LARGEST
_EXACT = 1024  # samples whose sum of products is below 2^24, so that float32 is exact

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
    samples = np.concatenate([tap[:, rows, columns] for tap in taps])
    weight = np.repeat(_tap_weights(), PLANES)
    _, components = np.linalg.eigh(_scatter(samples) * weight * weight[:, None])
    components = components[:, : -DIMENSIONS - 1 : -1].T * weight
    weights = np.rint(components * (LIMIT / np.abs(components).max())).astype(np.int8)
    sums = np.abs(weights[0].astype(np.float32) @ samples)
    large = max(float(np.quantile(sums, 1.0 - _CLIPPED)), 1.0)
    return Basis(weights, max(0, math.ceil(math.log2(large / LARGEST))), step)


def _scatter(samples: NDArray[np.integer]) -> NDArray[np.float64]:
    """(TAPS, TAPS) n times the covariance of (TAPS, n) samples, exact up to the means' product."""
    products = np.zeros((len(samples), len(samples)))
    for start in range(0, samples.shape[1], _EXACT):
        some = samples[:, start : start + _EXACT].astype(np.float32)
        products += some @ some.T
    sums = samples.sum(axis=1, dtype=np.float64)
    return products - np.outer(sums, sums / samples.shape[1])


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
    return np.exp(-(side[:, None] ** 2 + side[None, :] ** 2) / _FALL_OFF).ravel()


# k-coherence candidates [tong2002]: for every place of an exemplar the most similar other place.
#
# Approximate nearest neighbours of appearance vectors. Vectors are sorted by their projection on
# random directions, and each place tries its neighbours in that order; then, as in PatchMatch
# [barnes2009], the shifted candidates of its neighbours in the image. Directions are hashes and
# distances integers, so that the result is the same on every machine.

_ROUNDS = 4  # more find better candidates and take longer
_LINES = 2  # random directions in a round
_STEEPEST = 100  # largest component of a direction

_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
_SEED = 0x51417


@dataclass(frozen=True)
class Candidates:
    """The candidate of every place of a grid."""

    rows: NDArray[np.int32]
    """(H, W) coordinate of the candidates, grid steps."""
    columns: NDArray[np.int32]
    """(H, W) coordinate of the candidates, grid steps."""
    distances: NDArray[np.int32]
    """(H, W) squared difference of appearance."""


def find_candidates(appearance: Appearance, gap: int, allowed: tuple[slice, slice]) -> Candidates:
    """For each place the most similar place at least `gap` grid steps away along x or y.

    Args:
        appearance: (H, W, DIMENSIONS).
        gap: grid steps.
        allowed: slices of rows and columns that candidates lie in.
    """
    high, wide = appearance.shape[:2]
    own_rows, own_columns = np.mgrid[0:high, 0:wide].astype(np.int32)
    top, bottom = allowed[0].start, allowed[0].stop
    left, right = allowed[1].start, allowed[1].stop
    flat = appearance.reshape(-1, appearance.shape[2])

    # A vector is gathered as one number of 16 bytes: a third of the time.
    whole = flat.view(np.complex128)[:, 0]

    def distance(rows: NDArray[np.int32], columns: NDArray[np.int32]) -> NDArray[np.int32]:
        other = whole[rows * wide + columns].view(np.int16).reshape(appearance.shape)
        difference = (other - appearance).astype(np.int32)
        return np.einsum("hwd,hwd->hw", difference, difference)

    hashes = hash_places(_SEED, 0, np.arange(wide), np.arange(high)[:, None])
    best_rows = (draw(hashes, 0, bottom - top) + top).astype(np.int32)
    best_columns = (draw(hashes, 1, right - left) + left).astype(np.int32)
    best = np.full((high, wide), np.iinfo(np.int32).max, np.int32)

    def attempt(rows: NDArray[np.int32], columns: NDArray[np.int32]) -> None:
        rows, columns = rows.clip(top, bottom - 1), columns.clip(left, right - 1)
        near = (np.abs(rows - own_rows) < gap) & (np.abs(columns - own_columns) < gap)
        distances = distance(rows, columns)
        better = (distances < best) & ~near
        np.copyto(best, distances, where=better)
        np.copyto(best_rows, rows, where=better)
        np.copyto(best_columns, columns, where=better)

    first_rows, first_columns = best_rows.copy(), best_columns.copy()
    attempt(first_rows, first_columns)
    line = hash_places(_SEED, 1, np.arange(flat.shape[1]), np.zeros(1, np.int64))
    for index in range(_ROUNDS * _LINES):
        directions = draw(line, index, 2 * _STEEPEST + 1) - _STEEPEST
        order = _ordered(flat.astype(np.float32) @ directions.astype(np.float32))
        for before, after in ((order[:-1], order[1:]), (order[1:], order[:-1])):
            adjacent = np.empty_like(order)
            adjacent[before] = after
            adjacent[order[-1] if before[0] == order[0] else order[0]] = after[0]
            rows, columns = np.divmod(adjacent.reshape(high, wide).astype(np.int32), wide)
            attempt(rows, columns)
        if index % _LINES == _LINES - 1:
            for y, x in _NEIGHBOURS:
                rows, columns = (np.roll(one, (y, x), (0, 1)) for one in (best_rows, best_columns))
                attempt(rows + np.int32(y), columns + np.int32(x))
    return Candidates(best_rows, best_columns, best)


def _ordered(numbers: NDArray[np.float32]) -> NDArray[np.int64]:
    """Stable sorting indices of whole numbers below 2^24: sorted with their indices, not by them.

    A projection is at most LARGEST * steepest * DIMENSIONS, below 2^24, hence exact.
    """
    keys = (numbers.astype(np.int64) << 32) | np.arange(len(numbers))
    keys.sort()
    return np.asarray(keys & 0xFFFFFFFF, np.int64)


# Grids of the synthesis levels, the frame that places are limited to, and sizes of patches.

MOST_LEVELS = 5  # so that periods are multiples of 2^4 texels, as the decoder's
COST_BITS = 2  # the grid of placement costs has a step of 2^COST_BITS texels
FRAME_MARGIN = 3  # steps between places and the exemplar's border, for their neighbourhoods
_LEAST_STEPS = 8  # least width of the coarsest level's frame, in its steps


@dataclass(frozen=True)
class Frame:
    """Rectangle of the exemplar's texels that places are limited to, ends included."""

    left: int
    top: int
    right: int
    bottom: int

    @staticmethod
    def of(width: int, height: int) -> Frame:
        """All texels of an exemplar of this size."""
        return Frame(0, 0, width - 1, height - 1)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        return self.right - self.left + 1, self.bottom - self.top + 1

    def enlarged(self, bits: int) -> Frame:
        """Its texels of 2^-bits times the side."""
        right, bottom = (self.right + 1 << bits) - 1, (self.bottom + 1 << bits) - 1
        return Frame(self.left << bits, self.top << bits, right, bottom)

    def halved(self, bits: int) -> Frame:
        """The texels of 2^bits times the side that lie within it."""
        left, top = -(-self.left >> bits), -(-self.top >> bits)
        return Frame(left, top, (self.right + 1 >> bits) - 1, (self.bottom + 1 >> bits) - 1)


def frame_of(level: int, part: Frame) -> Frame:
    """The frame of a level's places, for the part of an exemplar that may be shown."""
    margin = FRAME_MARGIN << level
    return Frame(part.left + margin, part.top + margin, part.right - margin, part.bottom - margin)


def level_count(width: int, height: int) -> int:
    """Number of levels for an exemplar of this size; 0 if it is too small."""
    count = 0
    while count < MOST_LEVELS and min(width, height) >= (_LEAST_STEPS + 2 * FRAME_MARGIN) << count:
        count += 1
    return count


def grid_bits(level: int) -> int:
    """log2 of the step of a level's appearance grid: half its spacing, at least a texel."""
    return max(0, level - 1)


def similar_bits(level: int) -> int:
    """log2 of the step of a level's candidate grid: its spacing, at least two texels."""
    return max(1, level)


def step_of(level: int) -> int:
    """Steps of a level's appearance grid between its places."""
    return 2 if level else 1


def grids_of(features: FeatureMap, count: int) -> list[FeatureMap]:
    """The features on each level's appearance grid, smoothed to the level's spacing."""
    grids = [features]
    for _ in range(1, count):
        grids.append(smoothed(features))
        features = halved(features)
    return grids


# Sizes of the patches that a field's coarsest level is laid from, by its variety.

# Patches of the coarsest level, and corrections; docs/notes/field.md.
_PATCH = 128  # side of the smallest patches, texels
_PART = 2  # least ratio of the exemplar's shorter side to that
# Aspects of patches: the most, and the least that is worth it. Flash-lit relief, shown along x in
# more of a wide photograph, is up to 1.5.
MOST_ASPECT, _LEAST_ASPECT = 4.0, 2.0
_NARROWEST = 256.0  # texels, of patches that are fitted and longer than wide
_OVERLAP = 3  # steps of the coarsest level by which the largest patch is smaller than the frame


@dataclass(frozen=True)
class PatchSizes:
    """Sizes of patches, in texels of the grid of places."""

    width: int
    height: int
    cells: float
    """Approximate width of patches of a lattice; they are rounded to whole cells."""
    loose: bool
    """Variety 1: the smallest patches, not fitted to their neighbours."""
    whole: bool
    """Variety 0: all patches are alike, the exemplar repeats."""
    aspect: float = 1.0
    """Width over height by which patches are longer along the grain; see grain_aspect."""

    @staticmethod
    def of(
        frame: Frame,
        spacing: int,
        lattice: PhasedLattice | None,
        variety: float,
        aspect: float = 1.0,
    ) -> PatchSizes:
        """Patch sizes of a variety.

        Args:
            frame: of the coarsest level's places.
            spacing: of that level, texels.
            lattice: of the exemplar, or None.
            variety: 0 for the whole exemplar, 1 for the smallest patches.
            aspect: width over height of patches of the same area, as far as the frame reaches.
        """
        wide, high = frame.right - frame.left, frame.bottom - frame.top
        small = 1 << (min(_PATCH, min(wide, high) // _PART).bit_length() - 1)
        loose, largest = variety >= 1.0, [max(small, n - _OVERLAP * spacing) for n in (wide, high)]
        sides = [
            float(small) if loose else _across_borders(side, small, variety) for side in largest
        ]
        width, height = (
            max(1, round(min(side, most) / spacing)) * spacing
            for side, most in zip(_lengthened(sides, aspect, loose=loose), largest, strict=True)
        )
        if loose:
            return PatchSizes(width, height, LEAST_PATCH, loose, whole=False, aspect=aspect)
        cells = _between(min(largest), LEAST_PATCH, variety)
        if lattice is not None:
            cells = lattice.fitting_cells(cells, largest[0], largest[1])
        return PatchSizes(width, height, cells, loose, whole=variety <= 0.0, aspect=aspect)


def grain_aspect(appearance: Appearance, frame: Frame, bits: int) -> float:
    """Width over height of patches that cut the least of what they show.

    A seam cuts what changes along it. With E_x and E_y the mean squared differences of appearance
    along x and y, patches of a given area, w wide and h high, cut E_y / w + E_x / h, which is least
    at w / h = E_y / E_x: along the grain of wood, or down what has run down a wall. 1 if it is less
    than _LEAST_ASPECT, and at most MOST_ASPECT, either way.

    Args:
        appearance: (H, W, DIMENSIONS) of the coarsest level.
        frame: of its places, texels.
        bits: log2 of its step in texels.
    """
    rows = slice(frame.top >> bits, (frame.bottom >> bits) + 1)
    inside = appearance[rows, frame.left >> bits : (frame.right >> bits) + 1].astype(np.int64)
    along_y, along_x = (
        max(float(np.square(inside[2:] - inside[:-2]).mean()), 1.0)
        for inside in (inside, inside.swapaxes(0, 1))
    )
    aspect = along_y / along_x
    if max(aspect, 1.0 / aspect) < _LEAST_ASPECT:
        return 1.0
    return min(max(aspect, 1.0 / MOST_ASPECT), MOST_ASPECT)


def _lengthened(sides: list[float], aspect: float, *, loose: bool) -> list[float]:
    """Sides of patches that are `aspect` times as long along x over y, of the same area.

    Fitted ones get no narrower than _NARROWEST, and larger: only neighbours avoid what each other
    show, so that content would recur within view of those two rows away.
    """
    factors = math.sqrt(aspect), 1.0 / math.sqrt(aspect)
    least = [0.0 if loose else min(side, _NARROWEST) for side in sides]
    return [max(side * by, most) for side, by, most in zip(sides, factors, least, strict=True)]


def _across_borders(large: int, small: int, variety: float) -> float:
    """Side s, at most `large`, of patches that continue across the exemplar's borders.

    These are seams as well: 1 / s + 1 / large is the inverse of _between.
    """
    return 1.0 / max(variety * (1.0 / small - 1.0 / large), 1.0 / large)


def _between(large: int, small: int, variety: float) -> float:
    """Harmonic interpolation from `large` at 0 to `small` at 1; divisions are exact everywhere."""
    return 1.0 / ((1.0 - variety) / large + variety / small)
