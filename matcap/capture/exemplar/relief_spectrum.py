"""Stage relief spectrum: energies of relief and albedo by band (docs/notes/capture.md).

In come a photograph and predicted relief, out go the energies that the photograph measures, in
closed form (measure_relief_spectrum), and relief with these energies (equalise).

To first order log L = log albedo + g . grad h, where g = d log L / d slope: zero at
the mirror point, and growing with the angle of the light and with gloss. A stationary sample has
the same spectra everywhere, so in a window whose mean g along a direction is s, the energy of log
L in a band and that direction is

    E(s) = A m + 2 C s + S s^2,

where A is the energy of log albedo, S that of slopes, C their cross energy, and m, near 1, a
factor of the window common to all directions: specular radiance dilutes albedo, dark gaps most,
and lenses are soft towards the corners. At the mirror point both m and s are small, so m = 1
would mistake albedo for relief. As relief shows along the light only, a weighted regression over
windows and directions recovers A, S and the standard error of S.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.capture.exemplar.octaves import BANDS, COARSER, coarse_smoothed, enlarged, split
from matcap.files.threads import at_once

# Measurement and use of the spectrum; docs/notes/capture.md. NSD is the normalised style distance.

# Side of windows, texels, which overlap by half. Larger ones resolve longer waves, but fewer fit.
_WINDOW = 128
# Least visible share of a window; its energy is divided by that share. At 0.98 a photograph with
# sparkles has no window left.
_LEAST_SEEN = 0.75
_ROUNDS = 4  # of reweighting, as an energy's standard error is proportional to the energy
_FEWEST_WINDOWS = 8  # least number of windows for the three unknowns
_SCATTER = 2.0  # factor on standard errors, for windows that overlap and are shared by directions
# Prior standard deviation of d m / d (squared diffuse share). Specular radiance dilutes dark gaps
# far more than the mean, so m varies more than the share does.
_DILUTION = 5.0
RESPONSE_AROUND = 24.0  # texels, standard deviation of the blur of the sensitivity

# Scaling of predicted relief to the measured energies.

_MOST_LOG, _POSTERIOR_STEP = 5.0, 0.05  # range and step of the log factors searched
# Texels, standard deviation of local energies. Smaller values equalise a cell and its groove (at
# 20 a leather loses 0.1 NSD and a cloth gains as much), larger ones leave arcs around the mirror
# point.
_AROUND = 32.0
_DIRECTIONS = 8  # number of directional bands
_LEAST_GAIN, _MOST_GAIN = 0.25, 10.0  # limits of the local gain
# Power of the sensitivity as a weight. Larger values use only places where the light is parallel
# to the direction.
_SHARPNESS = 3.0
_SCALINGS = 3  # iterations of scaling bands to their energies, as neighbours overlap
# Largest factor on a band. At 5, leather's finest octave, which needs 11, stays too flat.
_MOST_FACTOR = 30.0
# Error of a direction's share over squared slopes: without, a steep rock gets a grain it lacks.
_BY_STEEPNESS = 12.0
_BY_DIRECTION = 1.0  # scale of the Cauchy prior of a direction's log factor
# Order of the slopes' directions from which on they are grooves: of brushed plastic, twill, gouged
# lacquer and wood 0.92 to 1.0, of surfaces without a direction up to 0.63 (docs/notes/capture.md).
# Scale of the prior of a direction's log factor there.
_GROOVED, _OF_GROOVES = 0.85, 10.0
# Energy of a band of height that does not follow log albedo, over that which does, from which on it
# is its own: of ten cloths 0.1, of granite 1 to 2.
_FOLLOWING = 0.5
_LEAST_SLOPE = 1e-4  # root-mean-square slope, lower limit of a band's and of its deviation

Height = NDArray[np.float32]
Doubles = NDArray[np.float64]

DIRECTIONS = 6


@dataclass(frozen=True)
class ReliefSpectrum:
    """Relief and albedo per band and direction, (len(BANDS), DIRECTIONS) each."""

    albedo: Doubles
    """Amplitude of log albedo, sqrt(A)."""
    slope: Doubles
    """Amplitude of the slope along the direction, sqrt(S)."""
    error: Doubles
    """Standard error of the slope energy S."""

    @property
    def deviation(self) -> Doubles:
        """(len(BANDS),) standard deviation of the slope energy, summed over directions."""
        return np.asarray(np.sqrt(np.square(self.error).sum(1)), np.float64)

    @property
    def relief(self) -> float:
        """Root-mean-square slope over all bands and directions."""
        return float(np.sqrt(np.square(self.slope).sum()))

    @property
    def across(self) -> float | None:
        """Direction across grooves, radians from x, y upwards; None if slopes have several.

        With the order R of directions a_k, the mean one is t: R e^2it = sum S_k e^2ia_k / sum S_k.
        """
        energy = np.square(self.slope).sum(0) + 1e-12
        turns = np.exp(2j * np.pi / DIRECTIONS * np.arange(DIRECTIONS))
        order = (energy * turns).sum() / energy.sum()
        return float(np.angle(order)) / 2.0 if abs(order) >= _GROOVED else None

    def document(self) -> dict[str, Any]:
        """JSON: `relief`, and for each of `bands` its `wavelengths` in texels, `albedo` and `slope`
        over all directions, `slopes` along 0, 30 ... 150 degrees from x, and `deviation`.
        """
        energy = np.square(self.slope)
        return {
            "relief": self.relief,
            "bands": [
                {
                    "wavelengths": list(BANDS[band]),
                    "albedo": float(np.sqrt(np.square(self.albedo[band]).sum())),
                    "slope": float(np.sqrt(energy[band].sum())),
                    "deviation": float(self.deviation[band]),
                    "slopes": self.slope[band].tolist(),
                }
                for band in range(len(BANDS))
            ],
        }


def measure_relief_spectrum(
    log: NDArray[np.float32],
    sensitivity: NDArray[np.float32],
    use: NDArray[np.bool_] | NDArray[np.float32],
    noise: float = 0.0,
    *,
    matte: NDArray[np.float32] | None = None,
) -> ReliefSpectrum | None:
    """Measure the energies of a photograph; None if too few windows are visible.

    Args:
        log: (H, W) log radiance less that of the coarse fit; invalid texels are interpolated.
        sensitivity: (2, H, W) d log L / d slope along x and y (upwards).
        use: (H, W) share of a texel that is visible and not clipped.
        noise: standard deviation of log radiance due to the sensor.
        matte: (H, W) diffuse share of the radiance; None for 1.
    """
    whole = _windows(log.shape)
    seen = _seen(use, whole)
    cuts = [cut for cut, share in zip(whole, seen, strict=True) if share >= _LEAST_SEEN]
    if len(cuts) < _FEWEST_WINDOWS:
        return None
    # Interpolated texels are smooth and lack energy.
    energy = _window_energies(log, cuts) / seen[seen >= _LEAST_SEEN, None, None]
    white = noise**2 * _sums(np.ones((_WINDOW, _WINDOW)), _bins()) / _WINDOW**2
    matte = np.ones_like(log) if matte is None else matte
    albedo, slope, error = _regressed(
        energy - white, white, _responses(matte, sensitivity, use, cuts)
    )
    return ReliefSpectrum(np.sqrt(albedo), np.sqrt(slope), error)


def _seen(use: NDArray[np.bool_] | NDArray[np.float32], cuts: list[tuple[slice, slice]]) -> Doubles:
    """(windows,) visible share of each, weighted by the squared window function."""
    counts = np.square(_hann())
    return np.array([(use[cut] * counts).sum() for cut in cuts]) / counts.sum()


def _window_energies(log: NDArray[np.float32], cuts: list[tuple[slice, slice]]) -> Doubles:
    """(windows, len(BANDS), DIRECTIONS) mean square of log radiance in each directional band."""
    window, bins = _hann(), _bins()
    power = float(np.square(window).sum())
    energies = []
    for cut in cuts:
        flat = log[cut] - (log[cut] * window).sum() / window.sum()
        spectrum = np.square(np.abs(np.fft.fft2(flat * window))) / power / flat.size
        energies.append(_sums(spectrum, bins))
    return np.array(energies)


def _responses(
    matte: NDArray[np.float32],
    sensitivity: NDArray[np.float32],
    use: NDArray[np.bool_] | NDArray[np.float32],
    cuts: list[tuple[slice, slice]],
) -> Doubles:
    """(windows, 6) means over visible texels: squared diffuse share d^2, and g's x, y, xx, xy, yy.

    Around a highlight g changes direction within a window: its mean is small, its square is not.
    """
    counts = np.square(_hann())
    responses = []
    for cut in cuts:
        weight = counts * use[cut]
        d, (x, y) = matte[cut], sensitivity[(slice(None), *cut)]
        total, products = weight.sum(), (d * d, x, y, x * x, x * y, y * y)
        responses.append([(weight * product).sum() / total for product in products])
    return np.array(responses, np.float64)


def _regressed(energy: Doubles, noise: Doubles, responses: Doubles) -> Doubles:
    """(3, len(BANDS), DIRECTIONS) A, S and the standard error of S, by regression (module).

    Args:
        energy: (windows, len(BANDS), DIRECTIONS) of log radiance, without the noise's.
        noise: (len(BANDS), DIRECTIONS) energy of the noise.
        responses: (windows, 6) from _responses.
    """
    matte, x, y, xx, xy, yy = responses.T
    # Beyond |g| of about 1 the first-order shading model fails, and near a highlight the direction
    # of g changes within a window.
    counts = 1.0 / (1.0 + xx + yy)
    angle = np.arange(DIRECTIONS)[:, None] * np.pi / DIRECTIONS
    c, s = np.cos(angle), np.sin(angle)
    slant, squared = c * x + s * y, c * c * xx + 2.0 * c * s * xy + s * s * yy
    bands = [
        _regress(slant, squared, matte, band.T, white, counts)
        for band, white in zip(energy.swapaxes(0, 1), noise, strict=True)
    ]
    return np.array(bands).swapaxes(0, 1)


def slope_spectrum(height: NDArray[np.float32]) -> Doubles:
    """(len(BANDS), DIRECTIONS) root-mean-square slopes of a height (H, W) in texels."""
    window = _hann()
    power = float(np.square(window).sum())
    across = np.gradient(height, axis=1)
    up = -np.gradient(height, axis=0)
    # One transform of both: the terms of either that are not its own cancel in symmetric bins.
    both = across + 1j * up

    def energy(cut: tuple[slice, slice]) -> Doubles:
        waves = np.fft.fft2((both[cut] - both[cut].mean()) * window)
        return np.asarray(np.square(waves.real) + np.square(waves.imag), np.float64)

    windows = _windows(height.shape)
    total = sum(at_once(*(partial(energy, cut) for cut in windows)), np.zeros_like(window))
    return np.sqrt(_sums(total, _bins()) / power / window.size / max(1, len(windows)))


def _hann() -> Doubles:
    """(window, window) Hann window."""
    hann = np.hanning(_WINDOW)
    return np.asarray(hann[:, None] * hann, np.float64)


def _windows(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Rows and columns of all windows of a plane (H, W)."""
    side = _WINDOW
    rows = range(0, shape[0] - side + 1, side // 2)
    columns = range(0, shape[1] - side + 1, side // 2)
    return [(slice(y, y + side), slice(x, x + side)) for y in rows for x in columns]


def _sums(spectrum: Doubles, bins: NDArray[np.int64]) -> Doubles:
    """(len(BANDS), DIRECTIONS) sums of a power spectrum (window, window); bins as of _bins."""
    sums = np.bincount(bins.ravel(), spectrum.ravel(), len(BANDS) * DIRECTIONS + 1)
    return np.asarray(sums[:-1].reshape(len(BANDS), DIRECTIONS), np.float64)


def _bins() -> NDArray[np.int64]:
    """(window, window) bin of each frequency, DIRECTIONS * band + direction with y upwards.

    Frequencies outside of all bands have the bin len(BANDS) * DIRECTIONS.
    """
    frequency = np.fft.fftfreq(_WINDOW)
    fx, fy = np.meshgrid(frequency, -frequency)
    radius, angle = np.hypot(fx, fy), np.arctan2(fy, fx)
    direction = np.rint(angle / (np.pi / DIRECTIONS)).astype(np.int64) % DIRECTIONS
    bins = np.full(radius.shape, len(BANDS) * DIRECTIONS)
    for band, (longest, shortest) in enumerate(BANDS):
        inside = (radius >= 1.0 / longest) & (radius < 1.0 / shortest)
        bins[inside] = DIRECTIONS * band + direction[inside]
    return bins


def _regress(
    slant: Doubles,
    squared: Doubles,
    matte: Doubles,
    energy: Doubles,
    noise: Doubles,
    counts: Doubles,
) -> Doubles:
    """(3, DIRECTIONS) A, S and S's standard error of a band, A and S not negative.

    Iteratively reweighted least squares over windows n and directions k,

        E_kn = A_k (1 + f_n + _DILUTION d (matte_n - mean)) + 2 C_k s_kn + S_k (s^2)_kn,

    with f_n and d ~ N(0, 1). Standard errors are proportional to the noise's energy and to what the
    previous round expects. A is taken from that round where it is multiplied by f_n or d, so that
    the equations are linear. f_n is eliminated (_whitened).

    Args:
        slant: (DIRECTIONS, N) mean of g along the direction, s, in each window.
        squared: (DIRECTIONS, N) mean of its square.
        matte: (N,) mean squared diffuse share.
        energy: (DIRECTIONS, N) energy of log radiance, without the noise's.
        noise: (DIRECTIONS,) energy of the noise.
        counts: (N,) weight of each window, at most 1.
    """
    count = len(energy)
    each = np.eye(count)[:, None, :]
    terms = (np.ones_like(slant), 2.0 * slant, squared)
    design = np.concatenate([each * term[..., None] for term in terms], axis=2)
    dilution = np.broadcast_to(_DILUTION * (matte - matte.mean()), energy.shape)
    prior = np.eye(3 * count + 1)[-1:]  # of d
    albedo = energy.mean(1, keepdims=True).clip(0.0)
    least, expected = 0.2 * albedo + 1e-12, np.full(energy.shape, albedo.mean() + 1e-12)
    for _ in range(_ROUNDS):
        weight = np.sqrt(counts) / (expected + noise[:, None])
        columns = np.concatenate([design, (dilution * albedo)[..., None]], axis=2)
        rows = np.concatenate([columns, energy[..., None]], axis=2) * weight[..., None]
        of_factor = albedo * weight  # the column of f
        white = _whitened(rows, of_factor)
        matrix = np.concatenate([white[..., :-1].reshape(-1, 3 * count + 1), prior])
        aim = np.append(white[..., -1], 0.0)
        solution = np.linalg.lstsq(matrix, aim, rcond=None)[0]
        left = rows[..., -1] - rows[..., :-1] @ solution
        factor = (of_factor * left).sum(0) / (1.0 + np.square(of_factor).sum(0))
        expected = np.maximum(columns @ solution + albedo * factor, least)
        albedo = solution[:count, None].clip(0.0)
    scatter = np.square(aim - matrix @ solution).sum() / max(count * (counts.sum() - 3.0), 1.0)
    slopes = slice(2 * count, 3 * count)
    variance = np.linalg.pinv(matrix.T @ matrix).diagonal()[slopes].clip(0.0)
    error = _SCATTER * np.sqrt(scatter * variance)
    return np.stack([albedo[:, 0], solution[slopes].clip(0.0), error])


def _whitened(rows: Doubles, column: Doubles) -> Doubles:
    """Eliminate an unknown f_n ~ N(0, 1) of each window n from equations of unit variance.

    With the column c of f_n, the errors of a window's equations have the covariance
    I + c c^T. Returned are the rows times its inverse square root,
    I - (1 - 1 / sqrt(1 + |c|^2)) c c^T / |c|^2.

    Args:
        rows: (DIRECTIONS, N, columns) of the equations.
        column: (DIRECTIONS, N) c.
    """
    size = np.square(column).sum(0)
    along = (1.0 - 1.0 / np.sqrt(1.0 + size)) / np.maximum(size, 1e-12) * column
    return np.asarray(rows - along[..., None] * (column[..., None] * rows).sum(0), np.float64)


def equalise(
    height: Height,
    spectrum: ReliefSpectrum | None,
    sensitivity: Height | None = None,
    albedo: Height | None = None,
) -> Height:
    """Height (H, W) in texels, with local slope energies equalised and bands scaled to `spectrum`.

    One flash shows slopes along its direction, hardly across it, and none at the mirror point; the
    network shrinks slopes that do not show. Relit, such relief is flat in the middle, with
    concentric ridges around it. So every octave is split into directional bands, and the local
    energy of each is normalised to its mean over places with high sensitivity in that direction.

    Args:
        height: (H, W) predicted, texels.
        spectrum: measured in the photograph; None keeps each band's mean energy.
        sensitivity: (2, H, W) d log L / d slope along x and y (upwards); None for a constant.
        albedo: (H, W) log albedo, for undrawn_factors(); None for an even one.
    """
    # The low-pass rest is an error of the highlight, shaped like a bowl, and is dropped.
    bands = split(height)[:-1]
    seen = _squares(np.ones((2, *height.shape), np.float32) if sensitivity is None else sensitivity)
    longest, _ = BANDS[0]  # wavelength, texels, by which the picture is mirrored at its borders
    margin = min(int(longest), *(side - 1 for side in height.shape))
    directions = [
        (share, _weight(angle, seen))
        for angle, share in _directions(tuple(side + 2 * margin for side in height.shape))
    ]
    evened = (partial(_evened, band, margin, directions) for band in bands)
    even = np.stack(at_once(*evened))  # each holds a spectrum and its copies
    wanted = slope_energies(height)
    if spectrum is not None:
        wanted = wanted * posterior_factors(BandEnergies.of(wanted, spectrum))
        if albedo is not None:
            drawn = np.stack(bands), np.stack(split(albedo)[:-1])
            wanted = wanted * undrawn_factors(wanted, *drawn, spectrum)
    factors: Doubles = np.ones(len(even))
    for _ in range(_SCALINGS):
        here = slope_energies(_sum(factors, even))
        factors = (factors * np.sqrt(wanted / here)).clip(1.0 / _MOST_FACTOR, _MOST_FACTOR)
    whole = _sum(factors, even)
    return whole if spectrum is None else _turned(whole, spectrum, margin)


def undrawn_factors(
    wanted: Doubles, height: Height, albedo: Height, spectrum: ReliefSpectrum
) -> Doubles:
    """(bands,) factors on squared slopes: what is dark is as deep in long waves as in steep ones.

    Where slopes are not measured, networks draw what is dark deep, in proportion to the wavelength:
    cloth gets pits. With the depth D_b of a band over that of its log albedo, the share a_b of its
    height's energy that follows log albedo (0 if what is dark is high), the steepest band r, its
    measured energy S_r and deviation d_r, and e = 1 / a_b - 1, longer bands b have the factor

        (1 - max(0, 1 - D_r / D_b) / (1 + (S_r / d_r)^4 + (e / _FOLLOWING)^2))^2.

    Args:
        wanted: (bands,) squared slopes.
        height, albedo: (bands, H, W) as predicted.
    """
    steepest = int(wanted.argmax())
    energy, tone, both = (
        np.einsum("nhw,nhw->n", one, other, dtype=np.float64).clip(1e-9)
        for one, other in ((height, height), (albedo, albedo), (height, albedo))
    )
    depth = np.sqrt(wanted / tone) * [math.sqrt(longest * shortest) for longest, shortest in BANDS]
    deeper = (1.0 - depth[steepest] / depth[:steepest]).clip(0.0)
    measured = np.square(spectrum.slope[steepest]).sum() / spectrum.deviation[steepest]
    own = (energy * tone / np.square(both) - 1.0)[:steepest] / _FOLLOWING
    factors = np.ones(len(wanted))
    factors[:steepest] -= deeper / (1.0 + measured**4 + np.square(own))
    return np.square(factors)


def _turned(height: Height, spectrum: ReliefSpectrum, margin: int) -> Height:
    """A height (H, W) whose directions have their measured shares of slope energy.

    The network draws bumps where grooves are brushed. With the shares p_bk of directions k in band
    b, the measured ones q_bk and d_bk, the error of S_bk over the band's sum and, as shading is of
    first order, _BY_STEEPNESS times the squared slopes of all,

        minimise  sum_b ((p_bk e^{y_k} - q_bk) / d_bk)^2 + 2 log(1 + (y_k / _BY_DIRECTION)^2)

    over the log factors y_k of all bands, whose prior is Cauchy's: most shares are predicted right,
    some not at all. Each band's energy is kept. Grooves get the measured shares: no error by
    steepness, and a prior of scale _OF_GROOVES.
    """
    energy = np.square(slope_spectrum(height)).clip(_LEAST_SLOPE**2)
    share = energy / energy.sum(1, keepdims=True)
    measured = np.square(spectrum.slope)
    total = measured.sum(1, keepdims=True) + _LEAST_SLOPE**2
    error = (spectrum.error + _LEAST_SLOPE**2) / total
    scale = _OF_GROOVES
    if spectrum.across is None:
        scale, error = _BY_DIRECTION, np.hypot(error, _BY_STEEPNESS * spectrum.relief**2)
    logs = np.arange(-_MOST_LOG, _MOST_LOG + _POSTERIOR_STEP / 2.0, _POSTERIOR_STEP)
    off = (share[..., None] * np.exp(logs) - (measured / total)[..., None]) / error[..., None]
    prior = 2.0 * np.log1p(np.square(logs / scale))
    factor = np.exp(logs[(np.square(off).sum(0) + prior).argmin(-1)])
    kept = share @ factor  # of each band's energy

    padded = np.pad(height, margin, mode="reflect")
    down, across = (np.fft.fftfreq(padded.shape[0]), np.fft.rfftfreq(padded.shape[1]))
    octave = np.log2(np.maximum(np.hypot(down[:, None], across), 1e-9))
    angle = np.arctan2(-down[:, None], across + np.zeros_like(octave))
    middles = [-0.5 * math.log2(longest * shortest) for longest, shortest in BANDS]
    steps = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    gain = np.interp(angle, steps, factor, period=np.pi) / np.interp(octave, middles, kept)
    waves = np.fft.rfft2(padded) * np.sqrt(gain)
    inside = tuple(slice(margin, margin + side) for side in height.shape)
    return np.fft.irfft2(waves, s=padded.shape)[inside].astype(np.float32)


def _sum(factors: Doubles, bands: Height) -> Height:
    """(H, W) sum of factors (N,) times bands (N, H, W), in fixed order for identical bits."""
    return np.asarray(np.einsum("n,nhw->hw", factors, bands, optimize=False), np.float32)


def _squares(sensitivity: Height) -> Height:
    """(3, h, w) products xx, xy and yy of the sensitivity, on the grid of coarse_smoothed."""
    x, y = sensitivity
    return np.stack([coarse_smoothed(product, COARSER) for product in (x * x, x * y, y * y)])


def _evened(band: Height, margin: int, directions: Sequence[tuple[Height, Doubles]]) -> Height:
    """Normalise the local energy of a band (H, W) in each direction to its mean where it shows.

    Args:
        band: of the relief.
        margin: texels by which it is mirrored at its borders.
        directions: filter of each direction (_directions), and weights of its energy (_weight).
    """
    height, width = band.shape
    padded = np.pad(band, margin, mode="reflect")
    spectrum = np.fft.rfft2(padded)
    inside = slice(margin, margin + height), slice(margin, margin + width)
    even = np.zeros_like(band)
    for share, weight in directions:
        waves = np.fft.irfft2(spectrum * share, s=padded.shape)[inside].astype(np.float32)
        energy = coarse_smoothed(np.square(waves), _AROUND)
        wanted = float((weight * energy).sum() / weight.sum())
        gain = np.sqrt(wanted / np.maximum(energy, 1e-20))
        gain = gain.clip(_LEAST_GAIN, _MOST_GAIN).astype(np.float32)
        even += enlarged(gain, band.shape) * waves
    return even


def _weight(angle: float, seen: Height) -> Doubles:
    """(h, w) weight of places by their sensitivity to slopes along `angle`, from _squares."""
    c, s = np.cos(angle), np.sin(angle)
    xx, xy, yy = seen.astype(np.float64)
    weight = np.maximum(c * c * xx + 2.0 * c * s * xy + s * s * yy, 0.0)
    return np.asarray((weight / max(float(weight.max()), 1e-12)) ** _SHARPNESS + 1e-9)


def _directions(shape: tuple[int, ...]) -> list[tuple[float, Height]]:
    """Angles in [0, pi), y upwards, and the filter on a real spectrum (h, w // 2 + 1) of each.

    The filters overlap smoothly and sum to 1.
    """
    count = _DIRECTIONS
    fx, fy = np.fft.rfftfreq(shape[1]), -np.fft.fftfreq(shape[0])[:, None]
    along = np.arctan2(fy, fx + np.zeros_like(fy))
    directions = []
    for angle in np.arange(count) * np.pi / count:
        off = (along - angle + np.pi / 2.0) % np.pi - np.pi / 2.0
        share = np.where(np.abs(off) < np.pi / count, np.square(np.cos(off * count / 2.0)), 0.0)
        directions.append((float(angle), share.astype(np.float32)))
    return directions


def slope_energies(height: Height) -> Doubles:
    """(len(BANDS),) mean squared slopes of a height (H, W) in texels."""
    return np.square(slope_spectrum(height)).sum(1).clip(_LEAST_SLOPE**2)


@dataclass(frozen=True)
class BandEnergies:
    """Energies of relief by band that are predicted, and their measurement."""

    predicted: Doubles
    """(bands,), positive."""
    measured: Doubles
    """(bands,), not negative."""
    deviation: Doubles
    """(bands,) standard deviations of `measured`."""

    @staticmethod
    def of(predicted: Doubles, spectrum: ReliefSpectrum) -> BandEnergies:
        """Of slope_energies(), and those measured in the photograph."""
        return BandEnergies(predicted, np.square(spectrum.slope).sum(1), spectrum.deviation)


def posterior_factors(*energies: BandEnergies) -> Doubles:
    """(bands,) factors on squared slopes: MAP estimate from a prediction and its measurements.

    With p_ib the predicted energy of band b, m_ib and d_ib the i-th measurement and its deviation,

        minimise  sum_ib ((p_ib e^{x_b} - m_ib) / d_ib)^2 + sum_b (x_b - c)^2 + c^2

    over the log factors x_b of each band and c common to all, by which the network shrinks
    uncertain relief. Well-measured bands take the measurement; bands measured as zero shrink by the
    inverse of its variance; bands without a measurement follow c.
    """
    logs = np.arange(-_MOST_LOG, _MOST_LOG + _POSTERIOR_STEP / 2.0, _POSTERIOR_STEP)
    off = sum(
        np.square(
            (each.predicted[:, None] * np.exp(logs) - each.measured[:, None])
            / (each.deviation[:, None] + _LEAST_SLOPE**2)
        )
        for each in energies
    )
    # (common, band, own): c, b and x_b of the docstring.
    price = np.square(logs - logs[:, None])[:, None, :] + off
    best = price.argmin(-1)
    total = price.min(-1).sum(1) + np.square(logs)
    return np.asarray(np.exp(logs[best[total.argmin()]]))
