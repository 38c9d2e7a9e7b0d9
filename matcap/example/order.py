"""The lattice of an exemplar (weave, tiles): its waves and their phase, kept in every field.

Photographs bend a lattice, so its phase is measured all over the exemplar; what is synthesised
has the ideal lattice of the same mean waves, whose phase is an integer of 64 bits that neither
drifts nor loses digits far away. Pieces are laid, and corrections held, in phase with it.

Phases are integers of 16 bits to a turn, which wrap as turns do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from matcap.example.hashing import scramble
from matcap.example.tuned import ORDER
from matcap.field.plane import Period

Phases = NDArray[np.int16]
Integers = NDArray[np.int64]
Frequency = tuple[float, float]  # cycles per texel along x (right) and y (down)

GRID = 4  # bits: phases are stored every 16 texels
_TURN = 1 << 16
_GOLDEN = 0x9E3779B97F4A7C15  # 2^64 / golden ratio: the step of splitmix64
_PHASES = 0x94D049BB133111EB  # sets its seeds apart from those of places


@dataclass(frozen=True)
class Order:
    """The lattice of an exemplar."""

    waves: tuple[Frequency, ...]
    """One or two."""
    bends: NDArray[np.int32]
    """(len(waves), H, W) int32: at every 16th texel, the phase beyond the wave's own, in 2^-16 of a
    turn; whole turns are kept, so that it varies slowly."""

    def moved(self, x: int, y: int) -> Order:
        """Of the part of the exemplar that begins at a texel; multiples of 2^GRID."""
        return replace(self, bends=self.bends[:, y >> GRID :, x >> GRID :])

    def periods(self) -> NDArray[np.int64]:
        """(2, len(waves)) by how much x and y change for a turn of each wave, in 1/256 texels."""
        if len(self.waves) == 1:
            ((ax, ay),) = self.waves
            area, columns = ax * ax + ay * ay, [[ax], [ay]]
        else:
            (ax, ay), (bx, by) = self.waves
            area, columns = ax * by - ay * bx, [[by, -ay], [-bx, ax]]
        return np.rint(256.0 * np.array(columns) / area).astype(np.int64)

    def piece(self, cells: float = ORDER.piece) -> float:
        """The least width of a piece in texels, where cells of so many are laid together."""
        return min(_together(wave, cells) / math.hypot(*wave) for wave in self.waves)

    def extent(self, cells: float) -> tuple[float, float]:
        """(width, height) in texels of a piece, and of a cell more, as it is moved into phase."""
        waves = _two(self, cells)
        (ax, ay), (bx, by) = waves
        area = ax * by - ay * bx
        counts = [_together(wave, cells) + 1 for wave in waves]
        return (
            (abs(by) * counts[0] + abs(ay) * counts[1]) / abs(area),
            (abs(bx) * counts[0] + abs(ax) * counts[1]) / abs(area),
        )

    def fitting(self, cells: float, width: float, height: float) -> float:
        """At most so many texels of cells together that pieces fit into a rectangle."""
        while cells > ORDER.piece:
            wide, high = self.extent(cells)
            if wide <= width and high <= height:
                return cells
            cells *= ORDER.smaller
        return ORDER.piece

    def phases(self, x: Integers, y: Integers) -> Phases:
        """(..., len(waves)) at places (x, y) of the exemplar, of shapes that broadcast."""
        return np.stack(
            [
                _bent(bend, x, y) + _straight(wave, (None, None), x, y)
                for wave, bend in zip(self.waves, self.bends, strict=True)
            ],
            axis=-1,
        ).astype(np.int16)

    def wanted(self, seed: int, x: Integers, y: Integers, period: Period) -> Phases:
        """(..., len(waves)) at texels (x, y) of the field, of shapes that broadcast.

        Args:
            seed: moves the lattice.
            x, y: texels.
            period: every wave is moved to the nearest one that fits it.
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
    """Where two waves begin, in 2^-64 turns."""
    counters = [((seed ^ _PHASES) + k * _GOLDEN) % 2**64 for k in (1, 2)]
    return [int(start) for start in scramble(np.array(counters, np.uint64))]


def _straight(
    wave: Frequency, period: Period, x: Integers, y: Integers, start: int = 0
) -> NDArray[np.int32]:
    """Phase of an ideal wave, from 64-bit turns."""
    turns_x, turns_y = (np.uint64(_turns(f, p)) for f, p in zip(wave, period, strict=True))
    turns = x.astype(np.uint64) * turns_x + y.astype(np.uint64) * turns_y + np.uint64(start)
    return (turns >> np.uint64(48)).astype(np.int32)


def _turns(frequency: float, period: int | None) -> int:
    """A frequency as 2^-64 turns per texel, moved to one that fits the period."""
    if period is None:
        return round(frequency * 2**64) % 2**64
    return round(round(frequency * period) * 2**64 / period) % 2**64


def _bent(bend: NDArray[np.int32], x: Integers, y: Integers) -> NDArray[np.int32]:
    """What lies between the places of a grid of 16 texels, bilinear; beyond it, its border."""
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
    """Which pieces of the lattice places of the field lie in: a few cells together."""

    column: Integers
    row: Integers
    """What a piece is called; the same wherever it is repeated."""
    middle_x: Integers
    middle_y: Integers
    """Of the piece, in texels."""


def cells_of(
    order: Order, seed: int, x: Integers, y: Integers, period: Period, cells: float = ORDER.piece
) -> Cells:
    """The pieces that texels (columns x, rows y), as vectors, lie in.

    A lattice of one wave is cut across, too. Cells of so many texels are laid together.
    """
    waves = _two(order, cells)
    starts = _starts(seed)
    counts, firsts, repeats = [], [], []
    for wave, start in zip(waves, starts, strict=True):
        steps = [_turns(f, p) for f, p in zip(wave, period, strict=True)]
        # Turns beyond half of 2^64 are backwards.
        steps = [step - 2**64 if step >= 2**63 else step for step in steps]
        counts.append(_whole_turns([steps[0] * int(c) + start for c in x], steps[1], y))
        repeats.append(
            tuple(0 if p is None else round(f * p) for f, p in zip(wave, period, strict=True))
        )
    names = _same(counts[0], counts[1], repeats[0], repeats[1])
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
    """Turns of a wave that one piece is long."""
    return max(1, round(cells * math.hypot(*wave)))


def _two(order: Order, cells: float) -> tuple[Frequency, Frequency]:
    """Its waves; of one alone, with another at right angles, as long as pieces are."""
    if len(order.waves) == 2:
        return order.waves[0], order.waves[1]
    (wave,) = order.waves
    length = math.hypot(*wave)
    return wave, (-wave[1] / (length * cells), wave[0] / (length * cells))


def _whole_turns(columns: list[int], step: int, y: Integers) -> Integers:
    """(len(y), len(columns)): the floor of column + step * y, where a turn is 2^64.

    Sums are exact: the lower 64 bits are added as they wrap, and carry where the sum is less than
    what was added.
    """

    def halves(values: list[int]) -> tuple[Integers, NDArray[np.uint64]]:
        high = np.array([value >> 64 for value in values], np.int64)
        return high, np.array([value % 2**64 for value in values], np.uint64)

    (column_high, column_low), (row_high, row_low) = (
        halves(columns),
        halves([step * int(row) for row in y]),
    )
    carry = (row_low[:, None] + column_low[None, :]) < column_low[None, :]
    return row_high[:, None] + column_high[None, :] + carry


def _same(
    first: Integers, second: Integers, one: tuple[int, ...], other: tuple[int, ...]
) -> tuple[Integers, Integers]:
    """Cells (first, second), of all those that a repeat makes one the same member.

    Args:
        first, second: whole turns of each wave.
        one, other: turns of the first wave, and of the second, after which the field repeats
            along x and along y; 0 where it never does.
    """
    # Repeats as pairs of turns; Euclid's algorithm leaves one that the first wave knows.
    along, down = (one[0], other[0]), (one[1], other[1])
    while down[0]:
        times = along[0] // down[0]
        along, down = down, (along[0] - times * down[0], along[1] - times * down[1])
    if along[0]:
        times_here = first // along[0]
        first, second = first - times_here * along[0], second - times_here * along[1]
        rest = abs(down[1])
    else:
        rest = math.gcd(along[1], down[1])
    return first, second % rest if rest else second


def measure_order(planes: NDArray[np.floating], waves: tuple[Frequency, ...]) -> Order | None:
    """The order of (C, H, W) planes of zero mean, given about where its waves are.

    None where a wave is too long for the exemplar, or is not to be seen.
    """
    measured = [_measured(planes, wave) for wave in waves]
    if not measured or any(one is None for one in measured):
        return None
    fitted = [one for one in measured if one is not None]
    order = Order(tuple(wave for wave, _ in fitted), np.stack([bend for _, bend in fitted]))
    joints = _joints(np.delete(planes, ORDER.slopes, axis=0), order)
    return Order(order.waves, order.bends - joints[:, None, None])


def _joints(planes: NDArray[np.floating], order: Order) -> NDArray[np.int32]:
    """(len(waves),) phases where the exemplar's cells differ least: there they are cut apart."""
    high, wide = planes.shape[1:]
    x, y = np.arange(0, wide, 2), np.arange(0, high, 2)
    phases = order.phases(x[None, :], y[:, None]).astype(np.int64) % _TURN
    bins = phases * ORDER.bins // _TURN
    place = bins[..., 0] if bins.shape[-1] == 1 else bins[..., 0] * ORDER.bins + bins[..., 1]
    place = place.ravel()
    size = ORDER.bins ** bins.shape[-1]
    count = np.maximum(np.bincount(place, minlength=size), 1)
    spread = np.zeros(size)
    for plane in planes[:, ::2, ::2].reshape(len(planes), -1):
        mean = np.bincount(place, plane, size) / count
        spread += np.bincount(place, plane * plane, size) / count - mean * mean
    joints = []
    for axis in range(bins.shape[-1]):
        grid = spread.reshape((ORDER.bins,) * bins.shape[-1])
        line = grid if grid.ndim == 1 else grid.mean(axis=1 - axis)
        smooth = np.roll(line, 1) + 2 * line + np.roll(line, -1)
        joints.append((2 * int(np.argmin(smooth)) + 1) * _TURN // (2 * ORDER.bins))
    return np.array(joints, np.int32)


def _measured(
    planes: NDArray[np.floating], wave: Frequency
) -> tuple[Frequency, NDArray[np.int32]] | None:
    """The mean wave, and its bends."""
    high, wide = planes.shape[1:]
    period = 1.0 / math.hypot(*wave)
    if ORDER.fewest * period > min(high, wide):
        return None
    deviation = min(ORDER.window * period, min(high, wide) / 4)
    x, y = np.arange(wide)[None, :], np.arange(high)[:, None]
    side = 1 << GRID
    rows, columns = np.arange(0, high + side, side), np.arange(0, wide + side, side)
    down, across = (
        _windows(n, at, deviation).astype(np.complex64) for n, at in ((high, rows), (wide, columns))
    )
    straight = wave[0] * x + wave[1] * y
    lag = max(1, round(ORDER.lag * deviation) >> GRID)
    bend = np.zeros((len(rows), len(columns)))
    for _ in range(ORDER.rounds):
        turns = straight + _bent(np.rint(bend * _TURN).astype(np.int64), x, y) / _TURN
        carrier = np.exp(-2j * np.pi * (turns - np.floor(turns))).astype(np.complex64)
        local = np.stack([(down @ (plane * carrier)) @ across.T for plane in planes])
        joined = _joined(local, lag)
        bend = bend + np.unwrap(np.unwrap(np.angle(joined), axis=0), axis=1) / (2.0 * np.pi)
    slope_x, slope_y, _ = _plane_fit(columns, rows, bend, np.abs(joined))
    mean = (wave[0] + slope_x, wave[1] + slope_y)
    bend = bend - slope_x * columns[None, :] - slope_y * rows[:, None]
    return mean, np.rint(bend * _TURN).astype(np.int32)


def _joined(local: NDArray[np.complexfloating], lag: int) -> NDArray[np.complexfloating]:
    """(H, W) of a wave in planes (C, H, W), which carry it in phases of their own.

    Each is turned to the steadiest one, and weighted by how steady it is: what differs from cell
    to cell at random, as colours of tiles do, has no phase. A bend hardly changes it `lag` places
    on.
    """
    power = (np.abs(local) ** 2).mean(axis=(1, 2)) + ORDER.faint
    on = (
        np.abs((local[:, lag:] * local[:, :-lag].conj()).mean(axis=(1, 2))),
        np.abs((local[:, :, lag:] * local[:, :, :-lag].conj()).mean(axis=(1, 2))),
    )
    steady = np.minimum(0.5 * (on[0] + on[1]) / power, ORDER.steadiest)
    reference = local[np.argmax(steady)]
    relation = (local * reference.conj()).mean(axis=(1, 2))
    weights = relation.conj() / (power * (1.0 - steady))
    return (local * weights[:, None, None]).sum(axis=0)


def _windows(length: int, centres: NDArray[np.int64], deviation: float) -> NDArray[np.float64]:
    """(len(centres), length) Gaussian windows of unit sum."""
    distance = np.arange(length)[None, :] - centres[:, None]
    windows = np.exp(-0.5 * (distance / deviation) ** 2)
    return windows / windows.sum(axis=1, keepdims=True)


def _plane_fit(
    columns: NDArray[np.int64],
    rows: NDArray[np.int64],
    values: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> tuple[float, float, float]:
    """The plane a x + b y + c nearest to values on a grid."""
    x, y = np.broadcast_arrays(columns[None, :], rows[:, None])
    design = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) * weight.reshape(-1, 1)
    (a, b, c), *_ = np.linalg.lstsq(design, (values * weight).ravel(), rcond=None)
    return float(a), float(b), float(c)
