"""Placement of a field's patches: what a centre costs, and how near to itself content recurs.

The cost of a centre is the mean placement cost of what its patch shows. Content that two patches
near each other both show is added to the cost of the later one, by its area and nearness.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from matcap.example.candidates import COST_BITS, SLOPES, Frame
from matcap.example.exemplar import Exemplar
from matcap.example.library import Hashes, Integers, Positions, draws, hash_places

# Placement of patches; docs/notes/field.md.
# Of new files. Without a rule it is 1: the cost of centres, and no cost of reuse. By 2, patches do
# not avoid what those at their corners show, and corrections avoid places at the full cost; by 3 at
# more than by 4 (index.py).
RULE = 4
_DRAWS = {1: 4, 2: 16, 3: 16, 4: 16}  # random places of which the one of least cost is taken
_FITTED = {1: 24, 2: 48, 3: 128, 4: 128}  # likewise of patches that are fitted to their neighbours
_REUSED = 1 << 24  # cost of a patch that a neighbour at no distance shows as well: four large seams
_NEAR = {2: 512, 3: 640, 4: 640}  # texels from which on content may recur at no cost
# Patches at a distance of up to this, in numbers, are of other colours: of squares, and of longer
# patches along and across them.
_REACH, _REACH_ALONG, _REACH_ACROSS = 2, 1, 4


@dataclass(frozen=True)
class Placement:
    """Costs of the centres of patches."""

    cost: NDArray[np.integer]
    """(H, W) of squares of 2^COST_BITS texels."""
    rule: int
    """Its version, 1 to RULE."""

    @staticmethod
    def of(
        cost: NDArray[np.int32], rule: int, sides: tuple[int, int], joined: Frame | None
    ) -> Placement:
        """Costs of patches of some size.

        Args:
            cost: (H, W) placement cost of squares of texels.
            rule: 1 to RULE.
            sides: width and height of a patch, texels.
            joined: the frame of which opposite borders adjoin, if patches continue across them.
        """
        if rule == 1:
            return Placement(cost, rule)
        columns = None if joined is None else (joined.left, joined.right)
        rows = None if joined is None else (joined.top, joined.bottom)
        return Placement(_means(_means(cost.T, sides[0], columns).T, sides[1], rows), rule)

    @property
    def draws(self) -> int:
        """Number of random places of which the one of least cost is taken."""
        return _DRAWS[self.rule]

    @property
    def fitted(self) -> int:
        """Number of random places that are fitted to neighbours."""
        return _FITTED[self.rule]

    @property
    def near(self) -> int:
        """Texels from which on content may recur at no cost; 0 if it may anywhere."""
        return _NEAR.get(self.rule, 0)

    def at(self, x: Integers, y: Integers) -> NDArray[np.integer]:
        """Costs of centres x, y."""
        return self.cost[y >> COST_BITS, x >> COST_BITS]

    def cheapest(self, hashes: Hashes, frame: Frame) -> Positions:
        """For every hash, the centre of least cost among random ones within a frame."""
        x, y = drawn_all(hashes, self.draws, frame)
        best = self.at(x, y).argmin(axis=0)[None]
        return np.take_along_axis(x, best, axis=0)[0], np.take_along_axis(y, best, axis=0)[0]


def _means(cost: NDArray[np.integer], side: int, joined: tuple[int, int] | None) -> Integers:
    """Means over `side` texels around each row, continued across the borders `joined`."""
    count, rows = max(1, side >> COST_BITS), len(cost)
    around = np.arange(-(count // 2), rows + count - count // 2 - 1)
    first, after = 0, rows
    if joined is not None:
        first, after = -(-joined[0] >> COST_BITS), (joined[1] + 1) >> COST_BITS
    at = around.clip(first, after - 1)
    if joined is not None:
        at = first + (around - first) % (after - first)
    sums = np.cumsum(cost[at], axis=0, dtype=np.int64)
    sums = np.concatenate([np.zeros_like(sums[:1]), sums])
    return np.asarray((sums[count:] - sums[:-count]) // count, np.int64)


def drawn_all(hashes: Hashes, attempts: int, frame: Frame) -> Positions:
    """(attempts, ...) random places within a frame for every hash."""
    x, y = (
        draws(hashes, range(first, 2 * attempts, 2), count)
        for first, count in enumerate(frame.size)
    )
    return frame.left + x, frame.top + y


def reuse_cost(
    shift: Positions,
    in_field: tuple[int, int],
    sides: tuple[int, int],
    near: int,
    wrap: tuple[int, int] | None = None,
) -> Integers:
    """Cost of what two patches both show: _REUSED * area * (1 - distance / near), by its parts.

    Args:
        shift: x, y of the centre of one less that of the other, in the exemplar, texels.
        in_field: the same in the field. With an equal shift one continues the other, at no cost.
        sides: width and height of a patch.
        near: see Placement.near.
        wrap: width and height of the exemplar, if patches continue across its borders.
    """
    turns = (0,) if wrap is None else (-1, 0, 1)
    wide, high = wrap or (0, 0)
    total = np.zeros(np.broadcast(*shift).shape, np.int64)
    for turn_y in turns:
        y = shift[1] + turn_y * high
        shown_y = np.maximum(sides[1] - np.abs(y), 0)
        for turn_x in turns:
            x = shift[0] + turn_x * wide
            area = np.maximum(sides[0] - np.abs(x), 0) * shown_y
            distance = np.maximum(np.abs(in_field[0] - x), np.abs(in_field[1] - y))
            within = np.maximum(near - distance, 0) * (distance > 0)
            total += area * within * (_REUSED // near) // (sides[0] * sides[1])
    return total


def spread_patches(
    placement: Placement,
    seed: int,
    depth: int,
    frame: Frame,
    axes: tuple[PatchNumbers, PatchNumbers],
) -> Positions:
    """(rows, columns) x, y at the centres of patches, each of little cost.

    Squares have nine colours by their numbers modulo 3, longer patches ten. Each is chosen after
    those of the colours before its own, of which it avoids what those within reach show: a patch
    depends on others within eight or nine times that, whatever else has been synthesised.

    Args:
        placement: costs of centres.
        seed, depth: of the field and its coarsest level, for the hashes.
        frame: of the centres.
        axes: numbers of patches along columns and rows.
    """
    across, down = axes
    reaches = _reaches(across.side, down.side)
    last = (reaches[0] + 1) * (reaches[1] + 1) - 1
    columns, rows = across.grown(last * reaches[0]), down.grown(last * reaches[1])
    hashes = hash_places(seed, depth, columns[None, :], rows[:, None])
    x, y = np.zeros((2, *hashes.shape), np.int64)
    for colour in range(last + 1):
        of_row, of_column = divmod(colour, reaches[0] + 1)
        wanted_x, wanted_y = (
            axis.grown((last - colour) * reach) for axis, reach in zip(axes, reaches, strict=True)
        )
        mine = (
            _of_colour(rows, wanted_y, of_row, reaches[1] + 1),
            _of_colour(columns, wanted_x, of_column, reaches[0] + 1),
        )
        if mine[0].size and mine[1].size:
            _choose(placement, hashes, frame, axes, mine, colour, (x, y))
    wanted = np.ix_(np.searchsorted(rows, down.numbers), np.searchsorted(columns, across.numbers))
    return x[wanted], y[wanted]


@dataclass(frozen=True)
class PatchNumbers:
    """Numbers of square patches along one axis."""

    numbers: Integers
    """Sorted; modulo `count`."""
    count: int | None
    """Patches in the period, or None."""
    side: int
    """Texels."""

    def grown(self, by: int) -> Integers:
        """Sorted numbers of these patches and of those within a distance."""
        near = np.unique(self.numbers[:, None] + np.arange(-by, by + 1))
        return near if self.count is None else np.unique(near % self.count)

    def shifted(self, numbers: Integers, by: int) -> Integers:
        """Numbers of the patches a distance away."""
        return numbers + by if self.count is None else (numbers + by) % self.count


def _reaches(width: int, height: int) -> tuple[int, int]:
    """Numbers along columns and rows up to which patches of some size avoid each other."""
    if width == height:
        return _REACH, _REACH
    return (_REACH_ALONG, _REACH_ACROSS) if width > height else (_REACH_ACROSS, _REACH_ALONG)


def _of_colour(numbers: Integers, wanted: Integers, colour: int, colours: int) -> Integers:
    """Indices of the numbers that are wanted and of one of the colours along their axis."""
    return np.flatnonzero(np.isin(numbers, wanted) & (numbers % colours == colour))


def _choose(
    placement: Placement,
    hashes: Hashes,
    frame: Frame,
    axes: tuple[PatchNumbers, PatchNumbers],
    mine: Positions,
    colour: int,
    chosen: Positions,
) -> None:
    """Choose the patches in rows and columns `mine`, all of one colour, into `chosen`."""
    across, down = axes
    reaches, sides = _reaches(across.side, down.side), (across.side, down.side)
    colours = reaches[0] + 1, reaches[1] + 1
    last, here = colours[0] * colours[1] - 1, np.ix_(*mine)
    columns, rows = (axis.grown(last * by) for axis, by in zip(axes, reaches, strict=True))
    x, y = drawn_all(hashes[here], placement.draws, frame)
    cost = placement.at(x, y).astype(np.int64)
    for dy in range(-reaches[1], reaches[1] + 1):
        others_y = down.shifted(rows[mine[0]], dy)
        for dx in range(-reaches[0], reaches[0] + 1):
            others_x = across.shifted(columns[mine[1]], dx)
            earlier = others_y[:, None] % colours[1] * colours[0] + others_x % colours[0] < colour
            if not earlier.any():
                continue
            at = np.ix_(np.searchsorted(rows, others_y), np.searchsorted(columns, others_x))
            shift = x - chosen[0][at], y - chosen[1][at]
            in_field = -dx * sides[0], -dy * sides[1]
            cost += earlier * reuse_cost(shift, in_field, sides, placement.near)
    best = cost.argmin(axis=0)[None]
    for into, each in zip(chosen, (x, y), strict=True):
        into[here] = np.take_along_axis(each, best, axis=0)[0]


# Places whose texture departs from the rest by a trend across the exemplar.
#
# The flash shows relief along its own direction only, less of it far from its mirror point: relief
# is combed one way at the left of the photograph and another at its top. Patches from all sides
# make a quilt under any other light. A stationary material has no such trend, so what departs by
# one has a penalty; a material's own variation, as of stains, is no smooth function of place.
#
# Features of a place are the logarithm of the contrast and the orientation of the exemplar, shaded
# from the left and from the top. Their trend is a polynomial of place, shrunk by its F ratio.

# Trends of texture; docs/notes/field.md.
_DEGREE = 4  # of the polynomial: orientation around a mirror point is quadratic near to it
_LIGHTS = ((-0.86, 0.0, 0.51), (0.0, 0.86, 0.51))  # unit vectors, y upwards
_DARKEST, _GRAZING = 1e-4, 0.05  # lower limits of albedo and of the cosine to the light
_AROUND = 16.0  # texels, standard deviation of local averages, of contrast and of its high-pass
_INDEPENDENT = 56  # texels between independent local averages, 2 sqrt(pi) deviations
_CHANCE = 2.0  # F ratio up to which a trend may be chance
# Squares across, of a board of which each half predicts the other; shares of variance that no trend
# and a trend predict (creased leather 2065 0.09, black leather 0240 0.56, leather 0258 0.42).
_CELLS, _ROUGH, _SMOOTH = 5, 0.1, 0.3
# Change of log contrast, and of the orientation's components, that the eye sees between patches.
_VISIBLE = (0.12, 0.15, 0.15)
_FREE = 0.3  # share of the known places that has no penalty, those nearest to each other
_LEAST = 0.5  # departure without a penalty, in visible changes
_SLOPE, _MOST = 0.5, 60.0  # departure beyond those at which the penalty is largest; its value
# Share of shading in the energy of a lit exemplar (leather 0240: 0.022, marble 2056: 0) at which a
# trend of contrast counts half: where relief shows less, it is the material's albedo that varies.
_FAINT = 0.005
_THINNED = 8  # squares between the places that are compared
# Standard deviations of the blurs between octaves whose sharpness is evened, and around the one
# that they are compared with, texels; side of the squares of their local energies; largest gain,
# and range of gains that is worth a change.
_BLURS, _COARSE = (1.0, 2.0), (4.0, 8.0)
_SQUARE, _GAIN, _LEAST_GAIN = 16, 1.6, 0.1

Floats = NDArray[np.float32]


def trend_penalty(planes: Floats, known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Penalty of the squares of an exemplar that depart from most by a trend.

    Args:
        planes: (PLANES, H, W) of the exemplar (features.planes_of).
        known: (rows, columns) whether a square of 2^COST_BITS texels may be shown at all.
    """
    trend = texture_trend(planes, np.ones_like(known))
    some = trend[:, ::_THINNED, ::_THINNED].reshape(len(trend), -1).T
    some = some[known[::_THINNED, ::_THINNED].ravel()]
    if not len(some):
        return np.zeros(known.shape)
    distances = np.sqrt(np.square(some[:, None] - some[None]).mean(axis=2))
    nearest = np.quantile(distances, _FREE, axis=1)
    middle = some[int(nearest.argmin())][:, None, None]
    departure = np.sqrt(np.square(trend - middle).mean(axis=0))
    free = max(_LEAST, float(nearest.min()))
    return np.asarray(_MOST * ((departure - free) / _SLOPE).clip(0.0, 1.0), np.float64)


def texture_trend(planes: Floats, seen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(6, rows, columns) trend of contrast and orientation, in changes that the eye sees.

    Args:
        planes: (PLANES, H, W) of the exemplar (features.planes_of).
        seen: (rows, columns) of equal squares of it, those that the trend is fitted to.
    """
    independent = _INDEPENDENT * seen.shape[1] / planes.shape[2]
    trend = _trend(_local_features(planes, seen.shape), seen, independent)
    return trend / np.tile(_VISIBLE, 2)[:, None, None]


def _local_features(planes: Floats, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """(6, rows, columns): log contrast and two components of orientation, by light.

    With J the local mean of the gradient's outer product, log sqrt(trace J) (as far as relief has a
    share in it), (J_xx - J_yy) / trace J and 2 J_xy / trace J.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    tone = np.log(np.square(planes[:3]).mean(axis=0).clip(_DARKEST))
    right, down = planes[SLOPES]
    upright = 1.0 / np.sqrt(1.0 + np.square(right) + np.square(down))
    size, deviation = shape[::-1], _AROUND * shape[1] / planes.shape[2]

    def local(product: Floats) -> Floats:
        thin = cv2.resize(product, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.GaussianBlur(thin, (0, 0), deviation), np.float32)

    features = []
    for x, y, z in _LIGHTS:
        cosine = ((z - x * right + y * down) * upright).clip(_GRAZING)
        log = np.asarray(tone + np.log(cosine), np.float32)
        fine, shaded = (
            cv2.GaussianBlur(each, (0, 0), 1.0) - cv2.GaussianBlur(each, (0, 0), _AROUND)
            for each in (log, np.asarray(np.log(cosine), np.float32))
        )
        share = float(np.square(shaded).mean() / (np.square(fine).mean() + 1e-9))
        along_y, along_x = np.gradient(fine)
        xx, yy, xy = (local(p) for p in (along_x**2, along_y**2, along_x * along_y))
        total = xx + yy + np.float32(1e-9)
        contrast = 0.5 * np.log(total) * share / (share + _FAINT)
        features += [contrast, (xx - yy) / total, 2.0 * xy / total]
    return np.stack(features).astype(np.float64)


# The photograph's sharpness has a trend as well: lenses are soft towards the corners, and a phone
# is held askew. Blur lowers fine octaves relative to coarse ones; veins and stains vary them all.


def evenly_sharp(exemplar: Exemplar) -> Exemplar:
    """An exemplar whose reflectance has no trend of sharpness.

    Of octaves b of log reflectance between Gaussian blurs, with local energies e_b, the trend of
    log sqrt(e_b / e_coarse) is divided out of the finer ones, by gains that keep their energy.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    def blurred(plane: Floats, deviation: float) -> Floats:
        return np.asarray(cv2.GaussianBlur(plane, (0, 0), deviation), np.float32)

    seen = exemplar.confidence.max(axis=0) > 0.0
    if not seen.any():
        return exemplar

    def logarithm(plane: Floats) -> Floats:
        """With the mean of what is seen where nothing is, which would else shine through."""
        log = np.log(plane.clip(_DARKEST))
        return np.asarray(np.where(seen, log, log[seen].mean()), np.float32)

    def softer(log: Floats, *deviations: float) -> Iterator[Floats]:
        """One after the other, as only two are needed at once."""
        yield log
        yield from (blurred(log, deviation) for deviation in deviations)

    wide, high = exemplar.size
    size = -(-wide // _SQUARE), -(-high // _SQUARE)
    grey = exemplar.diffuse.mean(axis=0) + exemplar.specular.mean(axis=0)
    energies = [
        blurred(cv2.resize(np.square(fine - soft), size, interpolation=cv2.INTER_AREA), 1.5)
        for fine, soft in pairwise(softer(logarithm(grey), *_BLURS, *_COARSE))
    ]
    *finer, _, coarse = (0.5 * np.log(energy + 1e-9) for energy in energies)
    known = np.asarray(
        cv2.resize(seen.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
    )
    features = np.stack([octave - coarse for octave in finer]).astype(np.float64)
    trends = _trend(features, known, _INDEPENDENT / _SQUARE)
    gains = [
        (np.sqrt(np.exp(2.0 * trend[known]).mean()) * np.exp(-trend)).clip(1.0 / _GAIN, _GAIN)
        for trend in trends
    ]
    if np.ptp(gains) < _LEAST_GAIN:
        return exemplar
    gains = [cv2.resize(gain.astype(np.float32), (wide, high)) for gain in gains]

    def evened(planes: Floats) -> Floats:
        if not np.ptp(planes):
            return planes
        even = planes.copy()
        for plane in even:
            log = logarithm(plane)
            octaves = softer(log.copy(), *_BLURS)
            for gain, (fine, soft) in zip(gains, pairwise(octaves), strict=True):
                log += (gain - 1.0) * (fine - soft)
            brighter = np.exp(log, out=log).clip(0.0, 1.0, out=log)
            np.copyto(plane, brighter, where=seen & (plane > _DARKEST))
        return even

    return replace(exemplar, diffuse=evened(exemplar.diffuse), specular=evened(exemplar.specular))


def _trend(
    features: NDArray[np.float64], seen: NDArray[np.bool_], independent: float
) -> NDArray[np.float64]:
    """Polynomials of place, fitted to places that are seen, times 1 - _CHANCE / F, F their F ratio.

    Elsewhere they stay within the range that is seen. Places this far apart are independent. All
    are multiplied by a ramp, from 0 at _ROUGH to 1 at _SMOOTH, of the share of variance that they
    predict (_predicted).
    """
    count, rows, columns = features.shape
    y, x = np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : columns * 1j]
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    design = np.stack([(x**i * y**j).ravel() for i, j in powers], axis=1)
    basis, flat, fit = np.linalg.qr(design)[0], features.reshape(count, -1).T, seen.ravel()
    if not fit.any():
        return np.zeros_like(features)
    fitted = basis @ _least_squares(basis[fit], flat[fit])
    fitted = fitted.clip(fitted[fit].min(axis=0), fitted[fit].max(axis=0))
    terms = len(powers) - 1
    free = max(float(fit.sum()) / independent**2 - terms - 1.0, 1.0)
    left = np.square(flat - fitted)[fit].mean(axis=0) / free
    ratio = fitted[fit].var(axis=0) / terms / np.maximum(left, 1e-12)
    kept = (1.0 - _CHANCE / np.maximum(ratio, _CHANCE)) * fitted
    square = np.add.outer(*((n * _CELLS // columns) for n in (np.arange(rows), np.arange(columns))))
    predicted = _predicted(basis[fit], flat[fit], square.ravel()[fit] % 2 > 0)
    kept *= min(1.0, max(0.0, predicted - _ROUGH) / (_SMOOTH - _ROUGH))
    return np.asarray(kept.T.reshape(features.shape), np.float64)


def _predicted(
    basis: NDArray[np.float64], flat: NDArray[np.float64], odd: NDArray[np.bool_]
) -> float:
    """Share of the variance of features that polynomials predict in the other squares of a board.

    What the flash does to texture is a smooth function of place; creases and stains in a few places
    are not, however much of the variance a polynomial fitted to all of them has.
    """
    if odd.all() or not odd.any():
        return 0.0
    missed = np.zeros(flat.shape[1])
    for half in (odd, ~odd):
        predicted = basis[~half] @ _least_squares(basis[half], flat[half])
        missed += np.square(flat[~half] - predicted).sum(axis=0)
    whole = len(flat) * np.maximum(flat.var(axis=0), 1e-12)
    return float((1.0 - missed / whole).clip(0.0).mean())


def _least_squares(basis: NDArray[np.float64], flat: NDArray[np.float64]) -> NDArray[np.float64]:
    gram = basis.T @ basis + 1e-9 * np.eye(basis.shape[1])
    return np.asarray(np.linalg.solve(gram, basis.T @ flat), np.float64)
