"""Regular order of an exemplar: the lattice of a weave or a bond, kept for ever.

Photographs bend a lattice, so its phase is measured all over the exemplar; what is synthesised
has the ideal lattice of the same mean waves, whose phase is an integer of 64 bits that neither
drifts nor loses digits far away. Pieces are laid, and corrections held, in phase with it.

Phases are integers of 16 bits to a turn, which wrap as turns do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.model.example.hashing import scramble

Phases = NDArray[np.int16]
Integers = NDArray[np.int64]
Period = tuple[int | None, int | None]
Wave = tuple[float, float]  # cycles per texel along x (right) and y (down)

GRID = 4  # bits: phases are stored every 16 texels
_TURN = 1 << 16
_WINDOW = 1.5  # periods: standard deviation of the window that a phase is measured in
_GOLDEN = 0x9E3779B97F4A7C15  # 2^64 / golden ratio: the step of splitmix64
_PHASES = 0x94D049BB133111EB  # sets its seeds apart from those of places


@dataclass(frozen=True)
class Order:
    """The lattice of an exemplar.

    Attributes:
        waves: one or two.
        bends: (len(waves), H, W) int32: at every 16th texel, the phase beyond the wave's own, in
            2^-16 of a turn; whole turns are kept, so that it varies slowly.
    """

    waves: tuple[Wave, ...]
    bends: NDArray[np.int32]

    def periods(self) -> NDArray[np.int64]:
        """(2, len(waves)) by how much x and y change for a turn of each wave, in 1/256 texels."""
        if len(self.waves) == 1:
            ((ax, ay),) = self.waves
            area, found = ax * ax + ay * ay, [[ax], [ay]]
        else:
            (ax, ay), (bx, by) = self.waves
            area, found = ax * by - ay * bx, [[by, -ay], [-bx, ax]]
        return np.rint(256.0 * np.array(found) / area).astype(np.int64)

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
        counters = [(seed ^ _PHASES) + k * _GOLDEN for k in range(1, len(self.waves) + 1)]
        starts = scramble(np.array([count % 2**64 for count in counters], np.uint64))
        return np.stack(
            [
                _straight(wave, period, x, y, int(start))
                for wave, start in zip(self.waves, starts, strict=True)
            ],
            axis=-1,
        ).astype(np.int16)


def _straight(
    wave: Wave, period: Period, x: Integers, y: Integers, start: int = 0
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


def measure_order(planes: NDArray[np.floating], waves: tuple[Wave, ...]) -> Order | None:
    """The order of (C, H, W) planes of zero mean, given about where its waves are.

    None where a wave is too long for the exemplar, or is not to be seen.
    """
    measured = [_measured(planes, wave) for wave in waves]
    if not measured or any(one is None for one in measured):
        return None
    found = [one for one in measured if one is not None]
    return Order(tuple(wave for wave, _ in found), np.stack([bend for _, bend in found]))


def _measured(planes: NDArray[np.floating], wave: Wave) -> tuple[Wave, NDArray[np.int32]] | None:
    """The mean wave, and its bends."""
    high, wide = planes.shape[1:]
    deviation = _WINDOW / math.hypot(*wave)
    if 4 * deviation > min(high, wide):
        return None
    x, y = np.arange(wide), np.arange(high)
    carrier = np.exp(-2j * np.pi * wave[1] * y)[:, None] * np.exp(-2j * np.pi * wave[0] * x)
    side = 1 << GRID
    rows, columns = np.arange(0, high + side, side), np.arange(0, wide + side, side)
    down, across = (_windows(n, at, deviation) for n, at in ((high, rows), (wide, columns)))
    local = np.stack([down @ (plane * carrier) @ across.T for plane in planes])
    # Planes carry the wave in phases of their own: turned to the strongest's, they add.
    strongest = local[np.argmax((np.abs(local) ** 2).sum(axis=(1, 2)))]
    turned = local * (local.conj() * strongest).sum(axis=(1, 2))[:, None, None]
    joined = turned.sum(axis=0)
    phase = np.unwrap(np.unwrap(np.angle(joined), axis=0), axis=1) / (2.0 * np.pi)
    weight = np.abs(joined)
    slope_x, slope_y, _ = _plane_fit(columns, rows, phase, weight)
    mean = (wave[0] + slope_x, wave[1] + slope_y)
    bend = phase - slope_x * columns[None, :] - slope_y * rows[:, None]
    return mean, np.rint(bend * _TURN).astype(np.int32)


def _windows(length: int, centres: NDArray[np.int64], deviation: float) -> NDArray[np.float64]:
    """(len(centres), length) Gaussian windows of unit sum."""
    apart = np.arange(length)[None, :] - centres[:, None]
    windows = np.exp(-0.5 * (apart / deviation) ** 2)
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
