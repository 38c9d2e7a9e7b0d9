"""Spectra, and the lattice of a regular texture: one or two frequency vectors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

# Power spectra of image windows, and autocorrelations.
#
# Spectra describe regular structure, which Gram matrices do not [liu2016] [henzler2021, sec. 4.3].
# The autocorrelation is the inverse Fourier transform of the power spectrum (Wiener-Khinchin);
# truncating it at a lag smooths the spectrum, which reduces the noise of a single window's
# estimate.


def power_spectrum(image: Tensor) -> Tensor:
    """(B, C, H, W // 2 + 1) power of (B, C, H, W) less its mean, under a Hann window.

    White noise of unit variance has unit expected power at every frequency.
    """
    height, width = image.shape[-2:]
    window = _hann(height, image)[:, None] * _hann(width, image)
    centred = image - image.mean(dim=(-2, -1), keepdim=True)
    return torch.fft.rfft2(centred * window).abs().square() / window.square().sum()


def autocorrelation(image: Tensor, lags: int) -> Tensor:
    """(B, C, lags + 1, 2 lags + 1) autocovariance of (B, C, H, W).

    Row r, column lags + c holds lag (r, c) in texels; the other half plane is its mirror image. Lag
    (0, 0) is the variance. The Hann window attenuates each lag, equally for all images of a size.
    """
    height, width = image.shape[-2:]
    rows = torch.fft.irfft2(power_spectrum(image), s=(height, width))[..., : lags + 1, :]
    return torch.cat([rows[..., -lags:], rows[..., : lags + 1]], dim=-1)


def _hann(size: int, like: Tensor) -> Tensor:
    return torch.hann_window(size, periodic=True, dtype=like.dtype, device=like.device)


# Lattice of a regular texture (weave, knit, tiles, stripes): one or two frequency vectors.
#
# The averaged power spectrum of a regular texture has sharp peaks at integer combinations of one or
# two frequency vectors. These vectors are inputs of the decoder (space/random_field.py).

# Tuned constants of the lattice's detection; docs/notes/prior.md.
_WINDOW = 256  # texels: side of the windows whose spectra are averaged
_PEAK_RATIO = 8.0  # least ratio of a peak to the median power of the 15 x 15 bins around it
_LEAST_SHARE = 0.004  # least share of the texture's power in a peak
_MOST_PEAKS = 12  # largest number of peaks that are used, the strongest
_LONGEST = 80.0  # texels: longest period that counts as regular
_TOLERANCE = 0.9  # spectral bins: largest distance of a peak from its lattice point
_LEAST_VARIANCE = 1e-4  # least variance of a window of the encoded picture; others are skipped
_MULTIPLES = (1, 2, 3, 4)  # multiples of a peak's period that are tried as the texture's period
_CLEARLY = 0.05  # gain in autocorrelation that a multiple needs to replace the single period
_REACH = 0.4  # largest shift, as a share of the picture's side
_NEAR = 2  # texels around a shift over which the autocorrelation's maximum is taken
_PADDED = 48  # texels of which a padded side is a multiple, for fast transforms
_SHADING = 255  # texels: side of the local mean that is subtracted as shading
# Share of the texture's power on the lattice below which there is no lattice.
_LEAST_EXPLAINED = 0.05

_ORDERS = range(-4, 5)


class Wave(NamedTuple):
    """A plane wave: cycles per texel along x (right) and y (down)."""

    fx: float
    fy: float


@dataclass(frozen=True)
class Lattice:
    """Frequency vectors that generate a texture's spectral peaks."""

    waves: tuple[Wave, ...]
    """Empty, one (stripes) or two (weaves, knits, tiles)."""
    share: float
    """Share of the texture's power in peaks on the lattice."""


def find_lattice(colour: Tensor, valid: Tensor) -> Lattice:
    """Detect the lattice of a texture.

    Of all bases of one or two candidate vectors, choose the one whose lattice holds most of the
    peaks' power, less a small cost for a second vector and for short vectors.

    Args:
        colour: (C, H, W) encoded picture of the plane, shading included.
        valid: (H, W) bool, texels inside the photograph and not clipped.
    """
    spectrum = _mean_spectrum(colour, valid)
    if spectrum is None:
        return Lattice((), 0.0)
    peaks, total = _peaks(spectrum)
    if not peaks:
        return Lattice((), 0.0)
    best: tuple[float, tuple[tuple[float, float], ...], float] = (0.0, (), 0.0)
    candidates = _candidates([(fx, fy) for fx, fy, _ in peaks])
    bases: list[tuple[tuple[float, float], ...]] = [
        *((c,) for c in candidates),
        *itertools.combinations(candidates, 2),
    ]
    for basis, power in zip(bases, _explained(bases, peaks), strict=True):
        explained = power / total
        # Among equals, prefer one vector to two and the smaller cell in space.
        cost = 0.02 * (len(basis) - 1) + 0.01 / _cell(basis)
        if explained - cost > best[0]:
            best = (explained - cost, basis, explained)
    if best[2] < _LEAST_EXPLAINED:
        return Lattice((), best[2])
    waves = tuple(Wave(fx / _WINDOW, fy / _WINDOW) for fx, fy in best[1])
    return Lattice(_whole_periods(waves, colour, valid), best[2])


def periodicity(colour: Tensor, valid: Tensor, waves: tuple[Wave, ...]) -> float:
    """Normalised autocorrelation of a texture at one period of its lattice, at most 1.

    Args:
        colour: (C, H, W) encoded picture of the plane, shading included.
        valid: (H, W) bool, texels inside the photograph and not clipped.
        waves: at least one; of two periods the smaller correlation is returned.
    """
    correlation = _autocorrelation_of(colour, valid)
    return min(correlation(x, y) for x, y in _periods(waves))


def _whole_periods(waves: tuple[Wave, ...], colour: Tensor, valid: Tensor) -> tuple[Wave, ...]:
    """Divide each frequency vector that is a harmonic by its order: the fundamentals.

    A check of period 87 whose third harmonic is strongest, or whose fundamental is too long for the
    windows, has its peak at period 29; its autocorrelation is higher at 87 texels than at 29.
    """
    correlation = _autocorrelation_of(colour, valid)
    fundamentals = []
    for wave, (x, y) in zip(waves, _periods(waves), strict=True):
        at = {m: correlation(m * x, m * y) for m in _MULTIPLES}
        times = max(_MULTIPLES, key=lambda m: at[m] - _CLEARLY * (m > 1))
        fundamentals.append(Wave(wave.fx / times, wave.fy / times))
    return tuple(fundamentals)


def _periods(waves: tuple[Wave, ...]) -> list[tuple[float, float]]:
    """For each wave the shift (x, y) in texels that turns it once, the other not at all."""
    if len(waves) == 1:
        square = waves[0].fx ** 2 + waves[0].fy ** 2
        return [(waves[0].fx / square, waves[0].fy / square)]
    a, b = waves
    area = a.fx * b.fy - a.fy * b.fx
    return [(b.fy / area, -b.fx / area), (-a.fy / area, a.fx / area)]


def _autocorrelation_of(colour: Tensor, valid: Tensor) -> Callable[[float, float], float]:
    """Normalised autocorrelation of a texture by shift (x, y) in texels; -1 at too large shifts.

    Over valid texels, after the local mean, which is shading, is subtracted. Planes are padded by
    what shifts reach, not to twice their size.
    """
    height, width = valid.shape
    seen = valid.to(colour.dtype)
    share = _local_means(seen[None]).clamp_min(1e-6)
    texture = (colour - _local_means(colour * seen) / share) * seen
    size = tuple(_PADDED * -(-int((1 + _REACH) * n + _NEAR + 2) // _PADDED) for n in valid.shape)

    def correlated(planes: Tensor) -> Tensor:
        power = torch.zeros(size[0], size[1] // 2 + 1)
        for plane in planes:  # one at a time, as a spectrum is large
            spectrum = torch.view_as_real(torch.fft.rfft2(plane, s=size))
            power += spectrum.square_().sum(-1)
        return torch.fft.irfft2(power, s=size)

    both = correlated(seen[None])
    correlation = correlated(texture) / both.clamp_min(1.0)
    variance = float(correlation[0, 0].clamp_min(1e-12))

    def at(x: float, y: float) -> float:
        if abs(x) > width * _REACH or abs(y) > height * _REACH:
            return -1.0
        rows = torch.arange(round(y) - _NEAR, round(y) + _NEAR + 1) % size[0]
        columns = torch.arange(round(x) - _NEAR, round(x) + _NEAR + 1) % size[1]
        return float(correlation[rows[:, None], columns].max()) / variance

    return at


def _local_means(planes: Tensor) -> Tensor:
    """Box averages over squares of _SHADING texels, padded with zeros."""
    square, zeros = (_SHADING, _SHADING), cv2.BORDER_CONSTANT
    means = [cv2.boxFilter(plane.numpy(), -1, square, borderType=zeros) for plane in planes]
    return torch.from_numpy(np.stack(means))


def _mean_spectrum(colour: Tensor, valid: Tensor) -> Tensor | None:
    """(W, W // 2 + 1) mean of windows' power spectra, each of unit mean; None without a window."""
    height, width = colour.shape[-2:]
    if min(height, width) < _WINDOW:
        return None
    step = _WINDOW // 2
    spectra = []
    for y in range(0, height - _WINDOW + 1, step):
        for x in range(0, width - _WINDOW + 1, step):
            if float(valid[y : y + _WINDOW, x : x + _WINDOW].float().mean()) < 0.9:
                continue
            window = colour[None, :, y : y + _WINDOW, x : x + _WINDOW]
            spectrum = power_spectrum(window)[0].sum(0)
            if float(spectrum.mean()) < _LEAST_VARIANCE:
                continue
            spectra.append(spectrum / spectrum[2:-1, 2:].mean().clamp_min(1e-12))
    return torch.stack(spectra).mean(0) if spectra else None


def _peaks(spectrum: Tensor) -> tuple[list[tuple[float, float, float]], float]:
    """Peaks (fx, fy, power) in cycles per window, strongest first; and the texture's power."""
    # The full plane with zero frequency at the centre, so that no neighbourhood crosses a border.
    full = torch.cat([spectrum, _mirror(spectrum)], dim=1)
    full = torch.fft.fftshift(full)
    middle = _WINDOW // 2
    around = F.pad(full[None, None], (7, 7, 7, 7), mode="circular")
    patches = F.unfold(around, 15).view(225, _WINDOW, _WINDOW)
    highest = F.max_pool2d(full[None, None], 5, stride=1, padding=2)[0, 0]
    rows, columns = torch.meshgrid(
        torch.arange(_WINDOW) - middle, torch.arange(_WINDOW) - middle, indexing="ij"
    )
    texture = (rows.square() + columns.square()).sqrt() >= _WINDOW / _LONGEST
    total = float(full[texture].sum())
    sums = F.avg_pool2d(full[None, None], 3, stride=1, padding=1)[0, 0] * 9.0
    half = (columns > 0) | ((columns == 0) & (rows > 0))
    row, column = ((full == highest) & texture & half).nonzero(as_tuple=True)
    # Only at local maxima, as the median is expensive.
    background = patches[:, row, column].median(dim=0).values
    mass = sums[row, column] - 9.0 * background
    is_peak = (full[row, column] > _PEAK_RATIO * background) & (2.0 * mass > _LEAST_SHARE * total)
    peaks = []
    for y, x, power in zip(*(v[is_peak].tolist() for v in (row, column, mass)), strict=True):
        fy, fx = _refine(full, y, x)
        peaks.append((fx - middle, fy - middle, 2.0 * power))
    peaks.sort(key=lambda peak: -peak[2])
    return peaks[:_MOST_PEAKS], total


def _mirror(spectrum: Tensor) -> Tensor:
    """The negative frequencies that rfft2 omits, by S(-f) = S(f)."""
    inner = spectrum[:, 1:-1].flip(1)
    return torch.cat([inner[:1], inner[1:].flip(0)], dim=0)


def _refine(full: Tensor, row: int, column: int) -> tuple[float, float]:
    """Peak position (row, column) in bins, by a parabola through the log power of neighbours."""

    def vertex(before: float, at: float, after: float) -> float:
        bend = before - 2.0 * at + after
        return 0.5 * (before - after) / bend if bend < 0 else 0.0

    log = full.clamp_min(1e-12).log()
    size = full.shape[0]
    up, down = float(log[(row - 1) % size, column]), float(log[(row + 1) % size, column])
    left, right = float(log[row, (column - 1) % size]), float(log[row, (column + 1) % size])
    at = float(log[row, column])
    return row + vertex(up, at, down), column + vertex(left, at, right)


def _candidates(peaks: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Candidate basis vectors: peaks, their halves, differences, half sums and half differences."""
    candidates = list(peaks)
    for fx, fy in peaks[:6]:
        candidates.append((fx / 2.0, fy / 2.0))
    for (ax, ay), (bx, by) in itertools.combinations(peaks[:6], 2):
        candidates += [((ax + bx) / 2.0, (ay + by) / 2.0), ((ax - bx) / 2.0, (ay - by) / 2.0)]
        candidates += [(ax - bx, ay - by)]
    least = _WINDOW / _LONGEST
    return [(fx, fy) for fx, fy in candidates if (fx * fx + fy * fy) ** 0.5 >= least]


def _cell(basis: tuple[tuple[float, float], ...]) -> float:
    """Size of the lattice's cell in bins: a vector's length, or the square root of the area."""
    if len(basis) == 1:
        return (basis[0][0] ** 2 + basis[0][1] ** 2) ** 0.5
    (ax, ay), (bx, by) = basis
    return max(abs(ax * by - ay * bx), 1e-9) ** 0.5


def _explained(
    bases: Sequence[tuple[tuple[float, float], ...]], peaks: list[tuple[float, float, float]]
) -> list[float]:
    """For each basis the power of the peaks on its lattice; 0 where its vectors are near parallel.

    Args:
        bases: one or two vectors each, in bins.
        peaks: (fx, fy, power), in bins.
    """
    nothing = (0.0, 0.0)
    waves = torch.tensor([(*basis, nothing)[:2] for basis in bases], dtype=torch.float64)
    orders = torch.tensor([o for o in itertools.product(_ORDERS, repeat=2) if any(o)]).double()
    places = torch.tensor([peak[:2] for peak in peaks], dtype=torch.float64)
    mass = torch.tensor([peak[2] for peak in peaks], dtype=torch.float64)
    points = torch.einsum("om,nmc->noc", orders, waves)
    # A basis of one vector generates only its own multiples, without the origin.
    lonely = waves[:, 1].abs().sum(dim=1) == 0
    points[lonely[:, None] & (orders[:, 0] == 0)] = math.inf
    hit = torch.zeros(len(bases), len(peaks), dtype=torch.bool)
    for index, place in enumerate(places):
        hit[:, index] = ((points - place).square().sum(dim=2) < _TOLERANCE**2).any(dim=1)
    # Nearly parallel vectors are two close frequencies, not a lattice.
    (ax, ay), (bx, by) = waves[:, 0].T, waves[:, 1].T
    lengths = waves[:, 0].norm(dim=1) * waves[:, 1].norm(dim=1)
    skew = ~lonely & ((ax * by - ay * bx).abs() < 0.3 * lengths)
    power: list[float] = torch.where(skew, 0.0, hit.double() @ mass).tolist()
    return power
