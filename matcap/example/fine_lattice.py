"""One cell all over an exemplar with a fine lattice, such as a weave on a curved seat.

Where cloth is bent, its lattice differs in shape and in contrast from place to place, and so would
patches of the field. The exemplar is resampled so that its lattice is straight; the lattice gets
the same cell everywhere and the rest even contrast, and modulation slower than some dozens of
periods, such as folds, is taken off.

Offsets at every 16th texel (lattice.py) are ambiguous at such periods. Here a polynomial phase is
fitted to local frequencies first. With z the maps demodulated by a wave f over a Gaussian window,
the frequency is f + Im(conj(z) grad z) / (2 pi |z|^2). The degree rises round by round.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.example.candidates import choose_scale, features_of, planes_of
from matcap.example.example import coarsened, detail_bits
from matcap.example.exemplar import Exemplar, Floats
from matcap.example.lattice import GRID, Frequency, gaussian_windows
from matcap.example.straighten import displacement, sources
from matcap.photo.inspect import blurred

# Straightening; docs/notes/field.md.
_FINE = 16.0  # texels, longest shorter period; offsets of longer ones are measured by lattice.py
_LEAST = 4.0  # texels, least range of displacements
# Degree of the polynomial and standard deviation of the windows, periods, of each round.
_ROUNDS = ((1, 1.5), (2, 2.0), (3, 2.0), (5, 2.5), (7, 2.5), (9, 2.5))
_LEFT = 0.25  # turns: 95 % of what the polynomial leaves is less, or there is no one lattice
_SMOOTH = 1.5  # grid steps, standard deviation of that rest
_ROBUST = 1.5  # robust standard deviations from which on a local frequency weighs less
# Periods, standard deviations of the windows of slow modulation, of harmonics and contrast, and of
# the lattice's mean.
_SLOW, _OUTER, _INNER = 12.0, 4.0, 1.5
_GAIN = 2.0  # largest gain of contrast
_HARMONICS, _FINEST = 3, 0.45  # largest order and frequency of a cell's harmonics
_STEADY = 0.5  # least |mean| over RMS of a harmonic's local coefficients
_COARSE = 8  # texels between these coefficients

Doubles = NDArray[np.float64]


def straightened(
    exemplar: Exemplar, waves: tuple[Frequency, ...]
) -> tuple[Exemplar, tuple[Frequency, ...]] | None:
    """An exemplar with a straight lattice of even mean and contrast, and the lattice's waves.

    None where it has no fine lattice of two waves, where that is straight already, or where the
    waves cannot be followed all over the exemplar.

    Args:
        exemplar: rounded as in a file.
        waves: approximate frequency vectors, cycles per texel.
    """
    bits = detail_bits(exemplar)
    if len(waves) != 2:
        return None
    short = shortest_waves(*(tuple(2**bits * f for f in wave) for wave in waves))
    if max(math.hypot(*wave) for wave in short) * _FINE < 1.0:
        return None
    planes = planes_of(coarsened(exemplar, bits))
    features = features_of(planes, choose_scale(planes)).astype(np.float32)
    features -= features.mean(axis=(1, 2), keepdims=True)
    paths = [followed(features, wave) for wave in short]
    if any(path is None for path in paths):
        return None
    means, turns = zip(*(path for path in paths if path is not None), strict=True)
    move = displacement(means, np.stack(turns))
    if np.ptp(move, axis=(1, 2)).max() < _LEAST:
        return None
    straight = _resampled(exemplar, move * 2.0**bits, 1 << (GRID + bits))
    at_full_size = tuple((float(fx) / 2**bits, float(fy) / 2**bits) for fx, fy in means)
    return _evened(straight, at_full_size).rounded(), at_full_size


def shortest_waves(first: tuple[float, ...], second: tuple[float, ...]) -> list[Frequency]:
    """The shortest two waves of the same lattice (Gauss's reduction), which are strongest."""
    a, b = np.array(first), np.array(second)
    while True:
        if a @ a > b @ b:
            a, b = b, a
        times = round(float(a @ b / (a @ a)))
        if not times:
            return [(float(a[0]), float(a[1])), (float(b[0]), float(b[1]))]
        b = b - times * a


@dataclass(frozen=True)
class _Sites:
    """A grid of 2^GRID texels over planes."""

    columns: NDArray[np.int64]
    rows: NDArray[np.int64]
    x: Doubles
    """(rows, columns), in half widths from the centre."""
    y: Doubles
    half: float
    """Half of the width, texels."""

    @staticmethod
    def of(height: int, width: int) -> _Sites:
        side, half = 1 << GRID, 0.5 * width
        columns, rows = np.arange(0, width, side), np.arange(0, height, side)
        x, y = np.meshgrid((columns - half) / half, (rows - 0.5 * height) / half)
        return _Sites(columns, rows, x, y, half)

    def monomials(self, degree: int, along_x: int = 0, along_y: int = 0) -> Doubles:
        """(rows * columns, terms) monomials of degrees 1 to `degree`, differentiated."""
        terms = []
        for a, b in itertools.product(range(degree + 1), repeat=2):
            if 1 <= a + b <= degree:
                factor = (a if along_x else 1) * (b if along_y else 1)
                powers = self.x ** max(a - along_x, 0) * self.y ** max(b - along_y, 0)
                terms.append((factor * powers / self.half ** (along_x + along_y)).ravel())
        return np.stack(terms, axis=1)

    def demodulated(
        self, planes: Floats, wave: Frequency, turns: Doubles, deviation: float
    ) -> tuple[NDArray[np.complex64], ...]:
        """(C, rows, columns) of planes times exp(-2 pi i phase), and derivatives along x and y."""
        height, width = planes.shape[1:]
        y, x = np.mgrid[:height, :width].astype(np.float32)
        bend = read_grid(turns, x / np.float32(1 << GRID), y / np.float32(1 << GRID))
        phase = (wave[0] * x.astype(np.float64) + wave[1] * y + bend) % 1.0
        carrier = np.exp(-2j * np.pi * phase).astype(np.complex64)
        (down, down_by), (across, across_by) = (
            (windows.astype(np.float32), (windows * from_centre).astype(np.float32))
            for windows, from_centre in (
                (gaussian_windows(n, at, deviation), (np.arange(n) - at[:, None]) / deviation**2)
                for n, at in ((height, self.rows), (width, self.columns))
            )
        )
        local = []
        for plane in planes:
            # Real windows of the line's real and imaginary parts: half of a complex product.
            parts = (plane * carrier).view(np.float32)
            rows, rows_by = ((window @ parts).view(np.complex64) for window in (down, down_by))
            local.append((rows @ across.T, rows @ across_by.T, rows_by @ across.T))
        return tuple(np.stack(each) for each in zip(*local, strict=True))


def followed(planes: Floats, wave: Frequency) -> tuple[Frequency, Doubles] | None:
    """A wave's mean frequency vector, and phase offsets from it in turns; None if it gets lost.

    Args:
        planes: (C, H, W) of zero mean.
        wave: approximate.
    """
    sites, period = _Sites.of(*planes.shape[1:]), 1.0 / math.hypot(*wave)
    turns = np.zeros_like(sites.x)
    for degree, periods in _ROUNDS:
        local, by_x, by_y = sites.demodulated(planes, wave, turns, periods * period)
        power = blurred(np.square(np.abs(local)).sum(axis=0), 1.0) + 1e-12
        slopes = [
            blurred((local.conj() * by).imag.sum(axis=0), 1.0) / (2.0 * np.pi * power)
            for by in (by_x, by_y)
        ]
        turns += _integral(sites, degree, slopes, power)
    for attempt in range(2):
        local, *_ = sites.demodulated(planes, wave, turns, 2.0 * period)
        reference = local[np.argmax(np.square(np.abs(local)).sum(axis=(1, 2)))]
        relation = (local * reference.conj()).sum(axis=(1, 2)).conj()
        joined = (local * relation[:, None, None]).sum(axis=0)
        joined = blurred(joined.real, _SMOOTH) + 1j * blurred(joined.imag, _SMOOTH)
        rest = np.angle(joined * joined.sum().conj()) / (2.0 * np.pi)
        if not attempt and np.quantile(np.abs(rest), 0.95) > _LEFT:
            return None
        turns = turns + rest
    plane = np.stack([sites.x, sites.y, np.ones_like(sites.x)], axis=-1).reshape(-1, 3)
    fit, *_ = np.linalg.lstsq(plane, turns.ravel(), rcond=None)
    mean = (wave[0] + float(fit[0]) / sites.half, wave[1] + float(fit[1]) / sites.half)
    return mean, turns - (plane @ fit).reshape(turns.shape)


def _integral(sites: _Sites, degree: int, slopes: list[Floats], power: Floats) -> Doubles:
    """The polynomial whose derivatives along x and y fit slopes best, by robust least squares."""
    design = np.concatenate([sites.monomials(degree, 1, 0), sites.monomials(degree, 0, 1)])
    wanted = np.concatenate([slope.ravel() for slope in slopes])
    strength = np.sqrt(np.minimum(power, np.quantile(power, 0.9))).ravel()
    weight = np.ones_like(strength)
    for _ in range(8):
        both = np.tile(strength * weight, 2)
        fit, *_ = np.linalg.lstsq(design * both[:, None], wanted * both, rcond=None)
        left = np.hypot(*np.split(wanted - design @ fit, 2))
        weight = (1.0 + np.square(left / (_ROBUST * 1.48 * np.median(left) + 1e-9))) ** -0.5
    return np.asarray((sites.monomials(degree) @ fit).reshape(power.shape))


def _resampled(exemplar: Exemplar, move: Doubles, step: int) -> Exemplar:
    """The exemplar read where p + move(p) is each texel; no confidence beyond its borders.

    Args:
        exemplar: at full size.
        move: (2, rows, columns) x, y in texels, at every `step` texels.
    """
    width, height = exemplar.size
    from_x, from_y = sources(move, step, exemplar.size, rounds=8)
    inside = (from_x >= 0) & (from_x <= width - 1) & (from_y >= 0) & (from_y <= height - 1)

    def read(planes: Floats, how: int) -> Floats:
        return np.stack(
            [cv2.remap(p, from_x, from_y, how, borderMode=cv2.BORDER_REFLECT) for p in planes]
        )

    return Exemplar(
        diffuse=read(exemplar.diffuse, cv2.INTER_CUBIC).clip(0.0, 1.0),
        specular=read(exemplar.specular, cv2.INTER_CUBIC).clip(0.0, 1.0),
        roughness=read(exemplar.roughness, cv2.INTER_CUBIC).clip(0.0, 1.0),
        height=read(exemplar.height, cv2.INTER_CUBIC),
        confidence=read(exemplar.confidence, cv2.INTER_LINEAR) * inside,
        texel_size=exemplar.texel_size,
    )


def read_grid(plane: Doubles, x: Floats, y: Floats) -> Floats:
    """Bilinear interpolation of a plane, whose borders are repeated."""
    values = plane.astype(np.float32)
    read = cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(read, np.float32)


def _evened(exemplar: Exemplar, waves: tuple[Frequency, ...]) -> Exemplar:
    """Log albedo and height without slow modulation, the lattice's cell the same everywhere."""
    log = np.log(np.maximum(exemplar.diffuse, np.float32(1e-3)))
    known = exemplar.confidence.max(axis=0)
    diffuse = np.exp(_even(log, waves, known)).clip(0.0, 1.0)
    return replace(exemplar, diffuse=diffuse, height=_even(exemplar.height, waves, known))


def _even(planes: Floats, waves: tuple[Frequency, ...], known: Floats) -> Floats:
    """Planes less what is slower than the lattice, with one cell, the rest of one local power."""
    period = 1.0 / max(math.hypot(*wave) for wave in waves)
    slow, mean = (
        np.stack([blurred(plane, times * period) for plane in planes]) for times in (_SLOW, _INNER)
    )
    local, cell = _cells(planes - mean, waves, known)
    fine = planes - mean - local
    power = np.square(fine.mean(axis=0))
    powers = np.maximum(blurred(power, _OUTER * period), 1e-12)
    gain = np.sqrt(power.mean() / powers).clip(1.0 / _GAIN, _GAIN)
    level = planes.mean(axis=(1, 2), keepdims=True)
    return np.asarray(level + mean - slow + cell + fine * gain, np.float32)


def _cells(planes: Floats, waves: tuple[Frequency, ...], known: Floats) -> tuple[Floats, Floats]:
    """The lattice that planes have locally, and with the same cell everywhere.

    Each harmonic of a plane is demodulated over _OUTER periods. In the second sum it has its mean
    phase and its RMS amplitude. Harmonics whose phase changes from place to place are in neither.

    Args:
        planes: (C, H, W) of zero mean.
        waves: exact frequency vectors of a straight lattice.
        known: (H, W) weights of the mean.
    """
    height, width = planes.shape[1:]
    size = (max(1, width // _COARSE), max(1, height // _COARSE))
    deviation = _OUTER / max(math.hypot(*wave) for wave in waves) / _COARSE
    weight = resized(known, size, cv2.INTER_AREA)
    weight /= max(float(weight.sum()), 1e-9)
    local, cell = np.zeros_like(planes), np.zeros_like(planes)
    for times in itertools.product(range(_HARMONICS + 1), range(-_HARMONICS, _HARMONICS + 1)):
        wave = np.array(times) @ np.array(waves)
        if times <= (0, 0) or np.abs(wave).max() > _FINEST:
            continue
        down, across = (
            np.exp(2j * np.pi * f * np.arange(n)).astype(np.complex64)
            for f, n in ((wave[1], height), (wave[0], width))
        )
        carrier = np.outer(down, across)
        parts = [np.ascontiguousarray(part) for part in (carrier.real, carrier.imag)]
        for plane, varying, constant in zip(planes, local, cell, strict=True):
            near = [blurred(resized(plane * p, size, cv2.INTER_AREA), deviation) for p in parts]
            mean = [float((weight * one).sum()) for one in near]
            rms = math.sqrt(float((weight * (near[0] ** 2 + near[1] ** 2)).sum()))
            if math.hypot(*mean) <= _STEADY * rms:
                continue
            for part, here, everywhere in zip(parts, near, mean, strict=True):
                varying += 2.0 * part * resized(here, (width, height), cv2.INTER_LINEAR)
                constant += np.float32(2.0 * everywhere * rms / math.hypot(*mean)) * part
    return local, cell


def resized(plane: Floats, size: tuple[int, int], how: int) -> Floats:
    """A plane at another size (width, height)."""
    return np.asarray(cv2.resize(plane, size, interpolation=how), np.float32)
