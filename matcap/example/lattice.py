"""The lattice of an exemplar (weave, tiles): frequency vectors, and the phase at every place.

In a photograph the lattice is bent, so that its phase is measured at every 16th texel. The field
has the ideal lattice of the same mean frequencies (field/plane.py): patches are laid in phase with
it, and corrections penalise phase errors.

Phases are 16-bit integers in units of 2^-16 turn, which wrap as turns do.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from matcap.example.library import Integers, same_cells, scramble, turns_per_texel, whole_turns
from matcap.field.plane import Period

Doubles = NDArray[np.float64]

# Measurement of a lattice and its patches; docs/notes/field.md.
_BINS = 24  # of a turn, for the search for joints
# Orders of the sums of one wave, and of two, that may take their places.
_ORDERS: dict[int, list[tuple[int, ...]]] = {
    1: [(1,)],
    2: [(1, 0), (0, 1), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1)],
}
_SLOPES = (5, 6)  # planes that are left out there, as they vary most at joints
LEAST_PATCH = 48  # least size of a patch of whole cells, texels
_SMALLER = 0.8  # factor by which patches shrink until they fit the exemplar
# Standard deviation of the Gaussian window of a phase, periods; less in small exemplars.
_WINDOW = 1.5
_FEWEST = 3.0  # least number of periods across an exemplar
_WELL_MEASURED = 6.0  # periods across an exemplar from which on phase offsets are a bend
_STRAIGHT = 4.0  # texels, largest range of a bend that patches may keep
_ROUGH = 1.0  # second difference of offsets along both axes, texels, from which on they are errors
_NEAR = 2  # texels around a period within which the largest correlation is taken
# Correlation at a period that makes a lattice, and gain over that at half a period if it is less:
# 0.06 to 0.22 and -0.1 to 0.09 on plaids and boards with waves of another order.
_ALIKE, _GAIN = 0.25, 0.1
_FAINT = 1e-9  # added to a plane's power, squared features
_LAG = 2.0  # distance at which coherence is measured, window deviations
_STEADIEST = 0.98  # upper limit of a plane's coherence, so that no plane dominates
_ROUNDS = 3  # iterations, as a window smooths phase offsets

Phases = NDArray[np.int16]

Frequency = tuple[float, float]  # cycles per texel along x (right) and y (down)

GRID = 4  # phase offsets are stored every 2^GRID texels
_TURN = 1 << 16
_GOLDEN = 0x9E3779B97F4A7C15  # 2^64 / golden ratio: the step of splitmix64
_PHASES = 0x94D049BB133111EB  # makes its random numbers independent of those of places


@dataclass(frozen=True)
class PhasedLattice:
    """The lattice of an exemplar."""

    waves: tuple[Frequency, ...]
    """One or two mean frequency vectors."""
    phase_offsets: NDArray[np.int32]
    """(len(waves), H, W): phase less that of the mean wave at every 16th texel, in 2^-16 turn,
    unwrapped."""

    def cropped(self, x: int, y: int) -> PhasedLattice:
        """The lattice of the exemplar cropped to begin at texel (x, y), multiples of 2^GRID."""
        return replace(self, phase_offsets=self.phase_offsets[:, y >> GRID :, x >> GRID :])

    def periods(self) -> NDArray[np.int64]:
        """(2, len(waves)) shift (x, y), 1/256 texel, that advances one wave only, by a turn."""
        if len(self.waves) == 1:
            ((ax, ay),) = self.waves
            area, columns = ax * ax + ay * ay, [[ax], [ay]]
        else:
            (ax, ay), (bx, by) = self.waves
            area, columns = ax * by - ay * bx, [[by, -ay], [-bx, ax]]
        return np.rint(256.0 * np.array(columns) / area).astype(np.int64)

    @cached_property
    def is_bent(self) -> bool:
        """Whether the exemplar's lattice has a smooth bend.

        Else it is straight, changes of offsets between grid places are errors, or a period is too
        short or too long for them to be measured.
        """
        turns = self.phase_offsets / _TURN
        bends = [np.diff(turns, 2, axis=axis) for axis in (1, 2)]
        rough = sum(np.quantile(np.abs(b - np.rint(b)), 0.75, axis=(1, 2)) for b in bends)
        period = 1.0 / np.hypot(*np.array(self.waves).T)
        shortest, longest = 1 << GRID, min(turns.shape[1:]) * (1 << GRID) / _WELL_MEASURED
        smooth = (rough * period < _ROUGH) & (shortest <= period) & (period <= longest)
        bend = np.ptp(turns, axis=(1, 2)) * period
        return bool(smooth.all() and bend.max() > _STRAIGHT)

    def patch_width(self, cells: float = LEAST_PATCH) -> float:
        """Least width in texels of a patch of whole lattice cells, of about `cells` texels."""
        return min(_together(wave, cells) / math.hypot(*wave) for wave in self.waves)

    def patch_extent(self, cells: float) -> tuple[float, float]:
        """(width, height) in texels of a patch plus a cell, by which it may be moved into phase."""
        waves = _two(self, cells)
        (ax, ay), (bx, by) = waves
        area = ax * by - ay * bx
        one, other = (_together(wave, cells) for wave in waves)
        counts = one + 1, other + (len(self.waves) > 1)  # across stripes alone there is a phase
        return (
            (abs(by) * counts[0] + abs(ay) * counts[1]) / abs(area),
            (abs(bx) * counts[0] + abs(ax) * counts[1]) / abs(area),
        )

    def fitting_cells(self, cells: float, width: float, height: float) -> float:
        """Largest size, at most `cells` texels, whose patches fit into a rectangle."""
        while cells > LEAST_PATCH:
            wide, high = self.patch_extent(cells)
            if wide <= width and high <= height:
                return cells
            cells *= _SMALLER
        return LEAST_PATCH

    def phases(self, x: Integers, y: Integers) -> Phases:
        """(..., len(waves)) phases of the exemplar at (x, y), of shapes that broadcast."""
        return np.stack(
            [
                _bent(bend, x, y) + _straight(wave, (None, None), x, y)
                for wave, bend in zip(self.waves, self.phase_offsets, strict=True)
            ],
            axis=-1,
        ).astype(np.int16)

    def in_phase(self, wanted: Phases, x: Integers, y: Integers) -> tuple[Integers, Integers]:
        """Places (x, y) moved by less than a period, so that they have the wanted phases."""
        turns = self.periods()
        for _ in range(2):  # again, as the lattice is bent
            phase_error = (wanted - self.phases(x, y)).astype(np.int64)
            x = x + ((phase_error @ turns[0] + (1 << 23)) >> 24)
            y = y + ((phase_error @ turns[1] + (1 << 23)) >> 24)
        return x, y

    def ideal_phases(self, seed: int, x: Integers, y: Integers, period: Period) -> Phases:
        """(..., len(waves)) phases of the field's ideal lattice at (x, y).

        Args:
            x, y: texels, of shapes that broadcast.
            period: of the field; each wave is replaced by the nearest one that repeats in it.
        """
        starts = _starts(seed)
        return np.stack(
            [
                _straight(wave, period, x, y, start)
                for wave, start in zip(self.waves, starts, strict=False)
            ],
            axis=-1,
        ).astype(np.int16)


def _starts(seed: int) -> list[int]:
    """Random phases of two waves at texel (0, 0), in 2^-64 turn."""
    counters = [((seed ^ _PHASES) + k * _GOLDEN) % 2**64 for k in (1, 2)]
    return [int(start) for start in scramble(np.array(counters, np.uint64))]


def _straight(
    wave: Frequency, period: Period, x: Integers, y: Integers, start: int = 0
) -> NDArray[np.int32]:
    """Phase of an ideal wave at (x, y), in 2^-16 turn; `start` is in 2^-64 turn."""
    turns_x, turns_y = (
        np.uint64(turns_per_texel(f, p) % 2**64) for f, p in zip(wave, period, strict=True)
    )
    turns = x.astype(np.uint64) * turns_x + y.astype(np.uint64) * turns_y + np.uint64(start)
    return (turns >> np.uint64(48)).astype(np.int32)


def _bent(bend: NDArray[np.int32], x: Integers, y: Integers) -> NDArray[np.int32]:
    """Bilinear interpolation of a grid of 2^GRID texels at (x, y), which are clamped to it."""
    side = 1 << GRID
    x = x.clip(0, (bend.shape[1] - 1) * side - 1)
    y = y.clip(0, (bend.shape[0] - 1) * side - 1)
    column, row, share_x, share_y = x >> GRID, y >> GRID, x & (side - 1), y & (side - 1)
    wide = bend.astype(np.int64)

    def across(row: Integers) -> Integers:
        return wide[row, column] * (side - share_x) + wide[row, column + 1] * share_x

    total = across(row) * (side - share_y) + across(row + 1) * share_y
    return (total >> (2 * GRID)).astype(np.int32)


@dataclass(frozen=True)
class Cells:
    """For each texel of a grid, the lattice patch that it lies in: a block of whole cells."""

    column: Integers
    """(rows, columns) number of the patch along the first wave, equal where the field repeats."""
    row: Integers
    """(rows, columns) number of the patch along the second wave."""
    middle_x: Integers
    """(rows, columns) centre of the patch, texels."""
    middle_y: Integers


def cells_of(
    lattice: PhasedLattice, seed: int, x: Integers, y: Integers, period: Period, cells: float
) -> Cells:
    """The lattice patches that texels lie in.

    A lattice of one wave is cut across as well (_two).

    Args:
        x, y: columns (N,) and rows (M,) of texels.
        period: of the field.
        cells: size of a patch, texels.
    """
    waves = _two(lattice, cells)
    starts = _starts(seed)
    counts, firsts, repeats = [], [], []
    for wave, start in zip(waves, starts, strict=True):
        along_x, along_y = (turns_per_texel(f, p) for f, p in zip(wave, period, strict=True))
        counts.append(
            whole_turns([along_x * int(c) + start for c in x], [along_y * int(r) for r in y])
        )
        repeats.append(
            [0 if p is None else round(f * p) for f, p in zip(wave, period, strict=True)]
        )
    (first_x, first_y), (second_x, second_y) = repeats
    names = same_cells(counts[0], counts[1], (first_x, second_x), (first_y, second_y))
    middles = []
    for wave, count, name, start in zip(waves, counts, names, starts, strict=True):
        together = _together(wave, cells)
        first = count - name % together
        middles.append(first + 0.5 * together - start / 2**64)
        firsts.append(name // together)
    (ax, ay), (bx, by) = waves
    area = ax * by - ay * bx
    return Cells(
        firsts[0],
        firsts[1],
        np.rint((by * middles[0] - ay * middles[1]) / area).astype(np.int64),
        np.rint((ax * middles[1] - bx * middles[0]) / area).astype(np.int64),
    )


def _together(wave: Frequency, cells: float) -> int:
    """Whole turns of a wave in one patch."""
    return max(1, round(cells * math.hypot(*wave)))


def _two(lattice: PhasedLattice, cells: float) -> tuple[Frequency, Frequency]:
    """The lattice's waves; with only one, a perpendicular one whose period is a patch's length.

    Patches of stripes are twice as long as wide: where two parts of a fabric meet, single stripes
    are off by up to a fifth of a period, so ends should be rare. The smallest patches are square.
    """
    if len(lattice.waves) == 2:
        return lattice.waves[0], lattice.waves[1]
    (wave,) = lattice.waves
    length = cells if cells <= LEAST_PATCH else 2.0 * cells
    turns = math.hypot(*wave) * length
    return wave, (-wave[1] / turns, wave[0] / turns)


def measure_lattice(
    planes: NDArray[np.floating], waves: tuple[Frequency, ...], *, straight: bool = False
) -> PhasedLattice | None:
    """Measure frequency vectors and phases of a lattice.

    Waves by which the exemplar does not repeat are left out. None without waves, or if a period is
    longer than a third of the exemplar.

    Args:
        planes: (C, H, W) of zero mean.
        waves: approximate frequency vectors.
        straight: whether they are exact, of a lattice without a bend.
    """
    measured = [_measured(planes, wave, straight) for wave in waves]
    if not measured or any(one is None for one in measured):
        return None
    fitted = [one for one in measured if one is not None]
    own, bends = zip(*fitted, strict=True)
    lattice = PhasedLattice(own, np.stack(bends))
    repeats = [_repeats(planes, period) for period in lattice.periods().T / 256.0]
    if not all(repeats):
        kept = tuple(wave for wave, one in zip(waves, repeats, strict=True) if one)
        return measure_lattice(planes, kept, straight=straight)
    return lattice


def _repeats(planes: NDArray[np.floating], period: Doubles) -> bool:
    """Whether planes (C, H, W) are like themselves a period away, more than half a period away."""
    high, wide = planes.shape[1:]

    def alike(x: int, y: int) -> float:
        sides = (y, high), (x, wide)
        rows, columns = (np.arange(max(0, -by), side - max(0, by), 4) for by, side in sides)
        if not (rows.size and columns.size):
            return 0.0
        here = planes[:, rows[:, None], columns]
        there = planes[:, rows[:, None] + y, columns + x]
        powers = np.square(here).sum() * np.square(there).sum()
        return float((here * there).sum() / np.sqrt(powers + _FAINT))

    x, y = (round(along) for along in period)
    near = range(-_NEAR, _NEAR + 1)
    once = max(alike(x + dx, y + dy) for dx in near for dy in near)
    return once > min(alike(round(period[0] / 2), round(period[1] / 2)) + _GAIN, _ALIKE)


def with_least_borders(planes: NDArray[np.floating], lattice: PhasedLattice) -> PhasedLattice:
    """The lattice by the waves, and from the phases, at which borders of cells differ least.

    Patches are cut where phases are 0. The variance v over cells is computed by phase, in _BINS
    bins, and is least at joints of tiles. Waves f, g and f, f + g generate the same lattice, but
    cells of the latter are cut aslant; the sum over both borders of v times length is the least.

    Args:
        planes: (C, H, W) of zero mean, features (candidates.py); slopes vary most at joints, and do
            not count.
    """
    planes = np.delete(planes, _SLOPES, axis=0)
    high, wide = planes.shape[1:]
    x, y = np.arange(0, wide, 2), np.arange(0, high, 2)
    phases = lattice.phases(x[None, :], y[:, None]).astype(np.int64) % _TURN
    bins = (phases * _BINS // _TURN).reshape(-1, len(lattice.waves)).T
    place = np.ravel_multi_index(tuple(bins), (_BINS,) * len(bins))
    size = _BINS ** len(bins)
    count = np.maximum(np.bincount(place, minlength=size), 1)
    spread = np.zeros(size)
    for plane in planes[:, ::2, ::2].reshape(len(planes), -1):
        mean = np.bincount(place, plane, size) / count
        spread += np.bincount(place, plane * plane, size) / count - mean * mean
    waves = np.array(lattice.waves)
    at = np.indices((_BINS,) * len(bins)).reshape(len(bins), -1)

    def border(orders: tuple[int, ...]) -> tuple[float, int]:
        """V times length in proportion, and the phase, of the best border of a wave."""
        line = np.bincount(np.dot(orders, at) % _BINS, spread, _BINS)
        smooth = np.roll(line, 1) + 2 * line + np.roll(line, -1)
        phase = (2 * int(np.argmin(smooth)) + sum(orders)) * _TURN // (2 * _BINS)
        return float(smooth.min() * np.hypot(*np.dot(orders, waves))), phase

    borders = {orders: border(orders) for orders in _ORDERS[len(waves)]}
    bases = [
        basis
        for basis in itertools.combinations(borders, len(waves))
        if abs(round(float(np.linalg.det(basis)))) == 1
    ]
    best = min(bases, key=lambda basis: sum(borders[orders][0] for orders in basis))
    joints = np.array([borders[orders][1] for orders in best], np.int32)
    offsets = np.tensordot(np.array(best, np.int32), lattice.phase_offsets, 1)
    frequencies = tuple((float(fx), float(fy)) for fx, fy in np.array(best) @ waves)
    return PhasedLattice(frequencies, offsets - joints[:, None, None])


def _measured(
    planes: NDArray[np.floating], wave: Frequency, straight: bool
) -> tuple[Frequency, NDArray[np.int32]] | None:
    """The mean frequency vector and phase offsets of a wave, by local demodulation.

    Planes times exp(-2 pi i phase) are averaged over Gaussian windows, whose angle is the phase
    offset; repeated _ROUNDS times, as a window smooths the offset.
    """
    high, wide = planes.shape[1:]
    period = 1.0 / math.hypot(*wave)
    if _FEWEST * period > min(high, wide):
        return None
    deviation = min(_WINDOW * period, min(high, wide) / 4)
    x, y = np.arange(wide)[None, :], np.arange(high)[:, None]
    side = 1 << GRID
    rows, columns = np.arange(0, high + side, side), np.arange(0, wide + side, side)
    if straight:
        return wave, np.zeros((len(rows), len(columns)), np.int32)
    down, across = (
        gaussian_windows(n, at, deviation).astype(np.complex64)
        for n, at in ((high, rows), (wide, columns))
    )
    even = wave[0] * x + wave[1] * y
    lag = max(1, round(_LAG * deviation) >> GRID)
    bend = np.zeros((len(rows), len(columns)))
    for _ in range(_ROUNDS):
        turns = even + _bent(np.rint(bend * _TURN).astype(np.int64), x, y) / _TURN
        carrier = np.exp(-2j * np.pi * (turns - np.floor(turns))).astype(np.complex64)
        local = np.stack([(down @ (plane * carrier)) @ across.T for plane in planes])
        joined = _joined(local, lag)
        bend = _unwrapped(bend + np.angle(joined) / (2.0 * np.pi))
    slope_x, slope_y, _ = _plane_fit(columns, rows, bend, np.abs(joined))
    mean = (wave[0] + slope_x, wave[1] + slope_y)
    bend = bend - slope_x * columns[None, :] - slope_y * rows[:, None]
    return mean, np.rint(bend * _TURN).astype(np.int32)


def _unwrapped(turns: Doubles) -> Doubles:
    """(H, W) phase in turns, less whole turns, without jumps: the most reliable steps first."""
    import cv2  # takes a tenth of a second, which synthesis is spared

    unwrapping = cv2.phase_unwrapping.HistogramPhaseUnwrapping
    parameters = unwrapping.Params()
    parameters.height, parameters.width = turns.shape
    wrapped = (2.0 * np.pi * (turns - np.rint(turns))).astype(np.float32)
    smooth = unwrapping.create(parameters).unwrapPhaseMap(wrapped) / (2.0 * np.pi)
    return np.asarray(turns + np.rint(smooth - turns), np.float64)


def _joined(local: NDArray[np.complexfloating], lag: int) -> NDArray[np.complexfloating]:
    """(H, W) weighted sum of demodulated planes (C, H, W), rotated to a common phase.

    The weight rises with a plane's coherence, the autocorrelation at `lag` grid steps over the
    power. It is low for planes that vary randomly between cells, as colours of tiles do.
    """
    power = (np.abs(local) ** 2).mean(axis=(1, 2)) + _FAINT
    on = (
        np.abs((local[:, lag:] * local[:, :-lag].conj()).mean(axis=(1, 2))),
        np.abs((local[:, :, lag:] * local[:, :, :-lag].conj()).mean(axis=(1, 2))),
    )
    steady = np.minimum(0.5 * (on[0] + on[1]) / power, _STEADIEST)
    relation = (local * local[np.argmax(steady)].conj()).mean(axis=(1, 2))
    weights = relation.conj() / (power * (1.0 - steady))
    return (local * weights[:, None, None]).sum(axis=0)


def gaussian_windows(length: int, centres: NDArray[np.int64], deviation: float) -> Doubles:
    """(len(centres), length) Gaussian windows of unit sum."""
    distance = np.arange(length)[None, :] - centres[:, None]
    windows = np.exp(-0.5 * (distance / deviation) ** 2)
    return windows / windows.sum(axis=1, keepdims=True)


def _plane_fit(
    columns: NDArray[np.int64], rows: NDArray[np.int64], values: Doubles, weight: Doubles
) -> tuple[float, float, float]:
    """(a, b, c) of the weighted least-squares plane a x + b y + c through values on a grid."""
    x, y = np.broadcast_arrays(columns[None, :], rows[:, None])
    design = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) * weight.reshape(-1, 1)
    (a, b, c), *_ = np.linalg.lstsq(design, (values * weight).ravel(), rcond=None)
    return float(a), float(b), float(c)
