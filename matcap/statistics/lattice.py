"""Lattice of a regular texture (weave, knit, tiles, stripes): one or two frequency vectors.

The averaged power spectrum of a regular texture has sharp peaks at integer combinations of one or
two frequency vectors. These vectors are inputs of the decoder (space/lattice_channels.py).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.statistics.spectrum import power_spectrum


@dataclass(frozen=True)
class LatticeSettings:
    """Tuned constants of the lattice's detection; docs/notes/prior.md."""

    window: int = 256
    """Texels: side of the windows whose spectra are averaged."""
    peak_ratio: float = 8.0
    """Least ratio of a peak to the median power of the 15 x 15 bins around it."""
    least_share: float = 0.004
    """Least share of the texture's power in a peak."""
    most_peaks: int = 12
    """Largest number of peaks that are used, the strongest."""
    longest: float = 80.0
    """Texels: longest period that counts as regular."""
    tolerance: float = 0.9
    """Spectral bins: largest distance of a peak from its lattice point."""
    least_variance: float = 1e-4
    """Least variance of a window of the encoded picture; others are skipped."""
    multiples: tuple[int, ...] = (1, 2, 3, 4)
    """Multiples of a peak's period that are tried as the texture's period."""
    clearly: float = 0.05
    """Gain in autocorrelation that a multiple needs to replace the single period."""
    reach: float = 0.4
    """Largest shift, as a share of the picture's side."""
    near: int = 2
    """Texels around a shift over which the autocorrelation's maximum is taken."""
    shading: int = 255
    """Texels: side of the local mean that is subtracted as shading."""
    least_explained: float = 0.05
    """Share of the texture's power on the lattice below which there is no lattice."""


LATTICE = LatticeSettings()

_ORDERS = range(-4, 5)


@dataclass(frozen=True)
class Wave:
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
    if best[2] < LATTICE.least_explained:
        return Lattice((), best[2])
    waves = tuple(Wave(fx / LATTICE.window, fy / LATTICE.window) for fx, fy in best[1])
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
        at = {m: correlation(m * x, m * y) for m in LATTICE.multiples}
        times = max(LATTICE.multiples, key=lambda m: at[m] - LATTICE.clearly * (m > 1))
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

    Over valid texels, after the local mean, which is shading, is subtracted.
    """
    height, width = valid.shape
    seen = valid.to(colour.dtype)
    share = _local_means(seen[None]).clamp_min(1e-6)
    texture = (colour - _local_means(colour * seen) / share) * seen
    size = (2 * height, 2 * width)

    def correlated(planes: Tensor) -> Tensor:
        power = torch.fft.rfft2(planes, s=size).abs().square().sum(0)
        return torch.fft.irfft2(power, s=size)

    both = correlated(seen[None])
    correlation = correlated(texture) / both.clamp_min(1.0)
    variance = float(correlation[0, 0].clamp_min(1e-12))

    def at(x: float, y: float) -> float:
        if abs(x) > width * LATTICE.reach or abs(y) > height * LATTICE.reach:
            return -1.0
        rows = torch.arange(round(y) - LATTICE.near, round(y) + LATTICE.near + 1) % size[0]
        columns = torch.arange(round(x) - LATTICE.near, round(x) + LATTICE.near + 1) % size[1]
        return float(correlation[rows[:, None], columns].max()) / variance

    return at


def _local_means(planes: Tensor) -> Tensor:
    """Box averages over squares of LATTICE.shading texels, padded with zeros."""
    half = LATTICE.shading // 2
    rows = F.avg_pool2d(planes, (LATTICE.shading, 1), stride=1, padding=(half, 0))
    return F.avg_pool2d(rows, (1, LATTICE.shading), stride=1, padding=(0, half))


def _mean_spectrum(colour: Tensor, valid: Tensor) -> Tensor | None:
    """(W, W // 2 + 1) mean of windows' power spectra, each of unit mean; None without a window."""
    height, width = colour.shape[-2:]
    if min(height, width) < LATTICE.window:
        return None
    step = LATTICE.window // 2
    spectra = []
    for y in range(0, height - LATTICE.window + 1, step):
        for x in range(0, width - LATTICE.window + 1, step):
            if float(valid[y : y + LATTICE.window, x : x + LATTICE.window].float().mean()) < 0.9:
                continue
            window = colour[None, :, y : y + LATTICE.window, x : x + LATTICE.window]
            spectrum = power_spectrum(window)[0].sum(0)
            if float(spectrum.mean()) < LATTICE.least_variance:
                continue
            spectra.append(spectrum / spectrum[2:-1, 2:].mean().clamp_min(1e-12))
    return torch.stack(spectra).mean(0) if spectra else None


def _peaks(spectrum: Tensor) -> tuple[list[tuple[float, float, float]], float]:
    """Peaks (fx, fy, power) in cycles per window, strongest first; and the texture's power."""
    # The full plane with zero frequency at the centre, so that no neighbourhood crosses a border.
    full = torch.cat([spectrum, _mirror(spectrum)], dim=1)
    full = torch.fft.fftshift(full)
    middle = LATTICE.window // 2
    around = F.pad(full[None, None], (7, 7, 7, 7), mode="circular")
    patches = F.unfold(around, 15).view(225, LATTICE.window, LATTICE.window)
    highest = F.max_pool2d(full[None, None], 5, stride=1, padding=2)[0, 0]
    rows, columns = torch.meshgrid(
        torch.arange(LATTICE.window) - middle, torch.arange(LATTICE.window) - middle, indexing="ij"
    )
    radius = (rows.square() + columns.square()).sqrt()
    texture = radius >= LATTICE.window / LATTICE.longest
    total = float(full[texture].sum())
    sums = F.avg_pool2d(full[None, None], 3, stride=1, padding=1)[0, 0] * 9.0
    half = (columns > 0) | ((columns == 0) & (rows > 0))
    row, column = ((full == highest) & texture & half).nonzero(as_tuple=True)
    # Only at local maxima, as the median is expensive.
    background = patches[:, row, column].median(dim=0).values
    mass = sums[row, column] - 9.0 * background
    is_peak = (full[row, column] > LATTICE.peak_ratio * background) & (
        2.0 * mass > LATTICE.least_share * total
    )
    peaks = []
    for y, x, power in zip(*(v[is_peak].tolist() for v in (row, column, mass)), strict=True):
        fy, fx = _refine(full, y, x)
        peaks.append((fx - middle, fy - middle, 2.0 * power))
    peaks.sort(key=lambda peak: -peak[2])
    return peaks[: LATTICE.most_peaks], total


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
    least = LATTICE.window / LATTICE.longest
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
        hit[:, index] = ((points - place).square().sum(dim=2) < LATTICE.tolerance**2).any(dim=1)
    # Nearly parallel vectors are two close frequencies, not a lattice.
    (ax, ay), (bx, by) = waves[:, 0].T, waves[:, 1].T
    lengths = waves[:, 0].norm(dim=1) * waves[:, 1].norm(dim=1)
    skew = ~lonely & ((ax * by - ay * bx).abs() < 0.3 * lengths)
    power: list[float] = torch.where(skew, 0.0, hit.double() @ mass).tolist()
    return power
