"""Energies of relief and albedo by band, measured from one flash photograph in closed form.

To first order log L = log albedo + g . grad h, where g = d log L / d slope (inputs.py): zero at the
mirror point, and growing with the angle of the light and with gloss. A stationary sample has the
same spectra everywhere, so in a window whose mean g along a direction is s, the energy of log L in
a band and that direction is

    E(s) = A m + 2 C s + S s^2,

where A is the energy of log albedo, S that of slopes, C their cross energy, and m, near 1, a factor
of the window common to all directions: specular radiance dilutes albedo, dark gaps most, and lenses
are soft towards the corners. At the mirror point both m and s are small, so m = 1 would mistake
albedo for relief. As relief shows along the light only, a weighted regression over windows and
directions recovers A, S and the standard error of S, to which the difference between two estimates
of g is added (docs/notes/capture.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Measurement and use of the relief spectrum; docs/notes/capture.md. NSD is the normalised style
# distance.

# Side and spacing of windows, texels. Larger windows resolve longer waves, but fewer fit.
_WINDOW, _STRIDE = 128, 64
# Least visible share of a window; its energy is divided by that share. At 0.98 a photograph with
# sparkles has no window left.
_LEAST_SEEN = 0.75
# |d log L/d slope| at which a window's weight drops to one half; beyond it the first-order
# shading model fails, and near a highlight its direction changes within a window. A cut-off at
# 0.8 or 2 instead gives the same within 1 %.
_LINEAR = 1.2
_ROUNDS = 4  # of reweighting, as an energy's standard error is proportional to the energy
_FEWEST_WINDOWS = 8  # least number of windows for the three unknowns
_SCATTER = 2.0  # factor on standard errors, for windows that overlap and are shared by directions
# Prior standard deviation of the coefficient of a window's m on the squared diffuse share, as dark
# gaps are diluted far more than by the share itself; that of m - 1 is 1.
_DILUTION = 5.0
_DISAGREED = 0.5  # share of the difference of two estimates that is added to the standard deviation
RESPONSE_AROUND = 24.0  # texels, standard deviation of the blur of the sensitivity

Doubles = NDArray[np.float64]

# Longest and shortest wavelength of each band, texels.
BANDS = tuple(pairwise((64.0, 32.0, 16.0, 8.0, 4.0, 2.8, 2.0)))
DIRECTIONS = 6


@dataclass(frozen=True)
class Strengths:
    """Root-mean-square amplitudes per band and direction, (len(BANDS), DIRECTIONS) each."""

    albedo: Doubles
    """Amplitude of log albedo, sqrt(A)."""
    slope: Doubles
    """Amplitude of the slope along the direction, sqrt(S)."""
    trust: Doubles
    """Significance of the slope energy, S^2 / (S^2 + standard error^2), in [0, 1]."""
    deviation: Doubles
    """(len(BANDS),) standard deviation of the slope energy, summed over directions."""

    @property
    def relief(self) -> float:
        """Root-mean-square slope over all bands and directions."""
        return float(np.sqrt(np.square(self.slope).sum()))

    def document(self) -> dict[str, Any]:
        """JSON: `relief`, and for each of `bands` its wavelengths in texels (`waves`), `albedo`,
        `slope` and `trust` over all directions, and `slopes` along 0, 30 ... 150 degrees from x.
        """
        energy = np.square(self.slope)
        trust = (self.trust * energy).sum(1) / np.maximum(energy.sum(1), 1e-12)
        return {
            "relief": self.relief,
            "bands": [
                {
                    "waves": list(BANDS[band]),
                    "albedo": float(np.sqrt(np.square(self.albedo[band]).sum())),
                    "slope": float(np.sqrt(energy[band].sum())),
                    "trust": float(trust[band]),
                    "slopes": self.slope[band].tolist(),
                }
                for band in range(len(BANDS))
            ],
        }


def measure_strengths(
    log: NDArray[np.float32],
    sensitivity: NDArray[np.float32],
    use: NDArray[np.bool_] | NDArray[np.float32],
    noise: float = 0.0,
    *,
    matte: NDArray[np.float32] | None = None,
    also: NDArray[np.float32] | None = None,
) -> Strengths | None:
    """Measure the energies of a photograph; None if too few windows are visible.

    Args:
        log: (H, W) log radiance less that of the coarse fit; invalid texels are interpolated.
        sensitivity: (2, H, W) d log L / d slope along x and y (upwards).
        use: (H, W) share of a texel that is visible and not clipped.
        noise: standard deviation of log radiance due to the sensor.
        matte: (H, W) diffuse share of the radiance; None for 1.
        also: (2, H, W) another estimate of `sensitivity`: the difference of their results adds to
            the standard deviation.
    """
    whole = _windows(log.shape)
    seen = _seen(use, whole)
    cuts = [cut for cut, share in zip(whole, seen, strict=True) if share >= _LEAST_SEEN]
    if len(cuts) < _FEWEST_WINDOWS:
        return None
    # Interpolated texels are smooth and lack energy.
    energy = _window_energies(log, cuts) / seen[seen >= _LEAST_SEEN, None, None]
    window = _WINDOW
    white = noise**2 * _sums(np.ones((window, window)), _kinds()) / window**2
    energy = np.maximum(energy - white, 0.0)
    matte = np.ones_like(log) if matte is None else matte
    albedo, slope, error = _regressed(energy, _responses(matte, sensitivity, use, cuts))
    disagreement = 0.0
    if also is not None:
        disagreement = np.abs(
            slope - _regressed(energy, _responses(matte, also, use, cuts))[1]
        ).sum(1)
    # Standard errors of directions are independent; model errors have one sign in all of them.
    deviation = np.hypot(np.sqrt(np.square(error).sum(1)), _DISAGREED * disagreement)
    return Strengths(
        albedo=np.sqrt(albedo),
        slope=np.sqrt(slope),
        trust=np.square(slope) / (np.square(slope) + np.square(error) + 1e-12),
        deviation=deviation,
    )


def _seen(use: NDArray[np.bool_] | NDArray[np.float32], cuts: list[tuple[slice, slice]]) -> Doubles:
    """(windows,) visible share of each, weighted by the squared window function."""
    counts = np.square(_hann())
    return np.array([(use[cut] * counts).sum() for cut in cuts]) / counts.sum()


def _window_energies(log: NDArray[np.float32], cuts: list[tuple[slice, slice]]) -> Doubles:
    """(windows, len(BANDS), DIRECTIONS) mean square of log radiance in each directional band."""
    window, kinds = _hann(), _kinds()
    power = float(np.square(window).sum())
    energies = []
    for cut in cuts:
        flat = log[cut] - (log[cut] * window).sum() / window.sum()
        spectrum = np.square(np.abs(np.fft.fft2(flat * window))) / power / flat.size
        energies.append(_sums(spectrum, kinds))
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
        responses.append(
            [(weight * v).sum() / weight.sum() for v in (d * d, x, y, x * x, x * y, y * y)]
        )
    return np.array(responses, np.float64)


def _regressed(energy: Doubles, responses: Doubles) -> Doubles:
    """(3, len(BANDS), DIRECTIONS) A, S and the standard error of S, by regression (module).

    Args:
        energy: (windows, len(BANDS), DIRECTIONS) of log radiance.
        responses: (windows, 6) from _responses.
    """
    matte, x, y, xx, xy, yy = responses.T
    counts = 1.0 / (1.0 + (xx + yy) / _LINEAR**2)
    angle = np.arange(DIRECTIONS)[:, None] * np.pi / DIRECTIONS
    c, s = np.cos(angle), np.sin(angle)
    slant, squared = c * x + s * y, c * c * xx + 2.0 * c * s * xy + s * s * yy
    bands = [_regress(slant, squared, matte, band.T, counts) for band in energy.swapaxes(0, 1)]
    return np.array(bands).swapaxes(0, 1)


def slope_strengths(height: NDArray[np.float32]) -> Doubles:
    """(len(BANDS), DIRECTIONS) root-mean-square slopes of a height (H, W) in texels."""
    window = _hann()
    power = float(np.square(window).sum())
    across = np.gradient(height, axis=1)
    up = -np.gradient(height, axis=0)
    total = np.zeros_like(window)
    count = 0
    # One transform of both: the terms of either that are not its own cancel in symmetric bins.
    both = across + 1j * up
    for cut in _windows(height.shape):
        waves = np.fft.fft2((both[cut] - both[cut].mean()) * window)
        total += np.square(waves.real) + np.square(waves.imag)
        count += 1
    return np.sqrt(_sums(total, _kinds()) / power / window.size / max(1, count))


def _hann() -> Doubles:
    """(window, window) Hann window."""
    hann = np.hanning(_WINDOW)
    return np.asarray(hann[:, None] * hann, np.float64)


def _windows(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Rows and columns of all windows of a plane (H, W)."""
    side, stride = _WINDOW, _STRIDE
    rows = range(0, shape[0] - side + 1, stride)
    columns = range(0, shape[1] - side + 1, stride)
    return [(slice(y, y + side), slice(x, x + side)) for y in rows for x in columns]


def _sums(spectrum: Doubles, kinds: NDArray[np.int64]) -> Doubles:
    """(len(BANDS), DIRECTIONS) sums of a power spectrum (window, window); bins as of _kinds."""
    sums = np.bincount(kinds.ravel(), spectrum.ravel(), len(BANDS) * DIRECTIONS + 1)
    return np.asarray(sums[:-1].reshape(len(BANDS), DIRECTIONS), np.float64)


def _kinds() -> NDArray[np.int64]:
    """(window, window) bin of each frequency, DIRECTIONS * band + direction with y upwards.

    Frequencies outside of all bands have the bin len(BANDS) * DIRECTIONS.
    """
    frequency = np.fft.fftfreq(_WINDOW)
    fx, fy = np.meshgrid(frequency, -frequency)
    radius, angle = np.hypot(fx, fy), np.arctan2(fy, fx)
    direction = np.rint(angle / (np.pi / DIRECTIONS)).astype(np.int64) % DIRECTIONS
    kinds = np.full(radius.shape, len(BANDS) * DIRECTIONS)
    for band, (longest, shortest) in enumerate(BANDS):
        inside = (radius >= 1.0 / longest) & (radius < 1.0 / shortest)
        kinds[inside] = DIRECTIONS * band + direction[inside]
    return kinds


def _regress(
    slant: Doubles, squared: Doubles, matte: Doubles, energy: Doubles, counts: Doubles
) -> Doubles:
    """(3, DIRECTIONS) A, S and S's standard error of a band, A and S not negative.

    Weighted least squares over all directions, with a factor m of each window that has a Gaussian
    prior; linear, as A in the product A m is that of the previous round. m is eliminated, as only
    its own window's residuals depend on it.

    Args:
        slant: (DIRECTIONS, N) mean of g along the direction, s, in each window.
        squared: (DIRECTIONS, N) mean of its square.
        matte: (N,) mean squared diffuse share.
        energy: (DIRECTIONS, N) energy of log radiance.
        counts: (N,) weight of each window, at most 1.
    """
    kinds = len(energy)
    each = np.eye(kinds)[:, None, :]
    terms = (np.ones_like(slant), 2.0 * slant, squared)
    own = np.concatenate([each * term[..., None] for term in terms], axis=2)
    drift = np.broadcast_to(_DILUTION * (matte - matte.mean()), energy.shape)
    prior = np.eye(3 * kinds + 1)[-1:]  # of the drift; that of m is in `white`
    least = 0.2 * energy.mean(1, keepdims=True) + 1e-12
    albedo, expected = energy.mean(1, keepdims=True), np.full(energy.shape, energy.mean() + 1e-12)
    for _ in range(_ROUNDS):
        weight = np.sqrt(counts) / expected
        columns = np.concatenate([own, (drift * albedo)[..., None]], axis=2)
        common = albedo * weight
        # With m eliminated, a window's errors have the covariance 1 + common common^T.
        size = np.square(common).sum(0)
        along = (1.0 - 1.0 / np.sqrt(1.0 + size)) / np.maximum(size, 1e-12) * common
        rows = np.concatenate([columns, energy[..., None]], axis=2) * weight[..., None]
        white = rows - along[..., None] * (common[..., None] * rows).sum(0)
        matrix = np.concatenate([white[..., :-1].reshape(-1, 3 * kinds + 1), prior])
        aim = np.append(white[..., -1], 0.0)
        solution = np.linalg.lstsq(matrix, aim, rcond=None)[0]
        left = rows[..., -1] - rows[..., :-1] @ solution
        factor = (common * left).sum(0) / (1.0 + size)
        expected = np.maximum(columns @ solution + albedo * factor, least)
        albedo = solution[:kinds, None].clip(0.0)
    scatter = np.square(aim - matrix @ solution).sum() / max(kinds * (counts.sum() - 3.0), 1.0)
    slopes = slice(2 * kinds, 3 * kinds)
    variance = np.linalg.pinv(matrix.T @ matrix).diagonal()[slopes].clip(0.0)
    error = _SCATTER * np.sqrt(scatter * variance)
    return np.stack([albedo[:, 0], solution[slopes].clip(0.0), error])
