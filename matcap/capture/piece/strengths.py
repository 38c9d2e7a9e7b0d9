"""What one flash photograph says outright of relief's and albedo's strength, in closed form.

To first order the logarithm of radiance is log albedo + g . grad h, where g is how log radiance
changes with slope (inputs.py): nothing under the flash's foot, more the further the light slants,
more again where gloss shows. A stationary sample has the same spectra everywhere, so in a window
whose mean g along a direction is s, the energy of the band's waves in that direction is

    E(s) = A + 2 C s + S s^2,

A albedo's energy, S the slopes', C how both go together. Windows differ in s, and a regression
over them recovers A and S, and how far S is to be doubted: by its scatter, by albedo that is not
as strong everywhere, and by what two opinions of g tell differently (docs/notes/exemplar.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.capture.piece.tuned import STRENGTH

Doubles = NDArray[np.float64]

# Waves of these lengths in texels, longest and shortest of each band.
BANDS = ((64.0, 32.0), (32.0, 16.0), (16.0, 8.0), (8.0, 4.0), (4.0, 2.8), (2.8, 2.0))
DIRECTIONS = 6


@dataclass(frozen=True)
class Strengths:
    """Root-mean-square strengths per band and direction, (len(BANDS), DIRECTIONS) each.

    Attributes:
        albedo: of log albedo.
        slope: of the slope along the direction.
        trust: how far the slope's strength stands out of its own scatter, 0 to 1.
        doubt: (len(BANDS),) what the slopes' energy, squared slopes of all directions together, may
            be off by (a standard deviation). Where nothing stands out it still is a bound.
    """

    albedo: Doubles
    slope: Doubles
    trust: Doubles
    doubt: Doubles

    @property
    def relief(self) -> float:
        """Root-mean-square slope of all bands and directions together."""
        return float(np.sqrt(np.square(self.slope).sum()))

    def doubts(self) -> list[float]:
        """Deviations of the logarithm of each band's root-mean-square slope."""
        energy = np.square(self.slope).sum(1)
        return (0.5 * self.doubt / np.maximum(energy, 1e-8)).tolist()

    def document(self) -> dict[str, Any]:
        """As JSON: `relief`, and for each of `bands` the lengths of its waves in texels
        (`waves`), `albedo` and `slope` of all directions together, how far the slope is to be
        trusted (`trust`), and `slopes` of waves along 0, 30 ... 150 degrees from x.
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
    shows: NDArray[np.float32],
    use: NDArray[np.bool_] | NDArray[np.float32],
    noise: float = 0.0,
    *,
    also: NDArray[np.float32] | None = None,
) -> Strengths | None:
    """Strengths of a photograph; None where too little of it can be used.

    Args:
        log: (H, W) log radiance over the coarse fit's; what is not used is filled from around it.
        shows: (2, H, W) change of log radiance with slope along x and y (upwards).
        use: (H, W) share of a texel that was seen and not clipped.
        noise: standard deviation of log radiance that is the sensor's.
        also: (2, H, W) another opinion of `shows`: where the two tell different strengths, what is
            told is doubted.
    """
    whole = _windows(log.shape)
    seen = _seen(use, whole)
    cuts = [cut for cut, share in zip(whole, seen, strict=True) if share >= STRENGTH.seen]
    if len(cuts) < STRENGTH.fewest:
        return None
    # What is filled is smooth, and lacks the energy of what it stands for.
    energy = _window_energies(log, cuts) / seen[seen >= STRENGTH.seen, None, None]
    window = STRENGTH.window
    white = noise**2 * _sums(np.ones((window, window)), _kinds()) / window**2
    energy = np.maximum(energy - white, 0.0)
    albedo, slope, error, uneven = _told(energy, _slants(shows, use, cuts))
    apart = 0.0
    if also is not None:
        apart = np.abs(slope - _told(energy, _slants(also, use, cuts))[1]).sum(1)
    # Scatter of directions cancels; what is wrong with the model goes the same way in all of them.
    doubt = np.hypot(np.sqrt(np.square(error).sum(1)), uneven.sum(1) + STRENGTH.disagreed * apart)
    own = np.square(error) + np.square(uneven)
    return Strengths(
        albedo=np.sqrt(albedo),
        slope=np.sqrt(slope),
        trust=np.square(slope) / (np.square(slope) + own + 1e-12),
        doubt=doubt,
    )


def _seen(use: NDArray[np.bool_] | NDArray[np.float32], cuts: list[tuple[slice, slice]]) -> Doubles:
    """(windows,) share of each that is used, texels counted as its energies count them."""
    counts = np.square(_hann())
    return np.array([(use[cut] * counts).sum() for cut in cuts]) / counts.sum()


def _window_energies(log: NDArray[np.float32], cuts: list[tuple[slice, slice]]) -> Doubles:
    """(windows, len(BANDS), DIRECTIONS) mean squares of log radiance."""
    window, kinds = _hann(), _kinds()
    power = float(np.square(window).sum())
    energies = []
    for cut in cuts:
        flat = log[cut] - (log[cut] * window).sum() / window.sum()
        spectrum = np.square(np.abs(np.fft.fft2(flat * window))) / power / flat.size
        energies.append(_sums(spectrum, kinds))
    return np.array(energies)


def _slants(
    shows: NDArray[np.float32],
    use: NDArray[np.bool_] | NDArray[np.float32],
    cuts: list[tuple[slice, slice]],
) -> Doubles:
    """(windows, 5) means of a response's x, y, xx, xy and yy over what is used of each window.

    Around a highlight the response turns within a window: its mean is little and its square is not.
    """
    counts = np.square(_hann())
    found = []
    for cut in cuts:
        weight = counts * use[cut]
        x, y = shows[(slice(None), *cut)]
        found.append([(weight * v).sum() / weight.sum() for v in (x, y, x * x, x * y, y * y)])
    return np.array(found, np.float64)


def _told(energy: Doubles, slants: Doubles) -> Doubles:
    """(4, len(BANDS), DIRECTIONS) A, S, S's standard error, and what of A may pass for S.

    Args:
        energy: (windows, len(BANDS), DIRECTIONS).
        slants: (windows, 5) as _slants has them.
    """
    x, y, xx, xy, yy = slants.T
    linear = 1.0 / (1.0 + (xx + yy) / STRENGTH.linear**2)
    found = np.zeros((4, len(BANDS), DIRECTIONS))
    for direction in range(DIRECTIONS):
        angle = direction * np.pi / DIRECTIONS
        c, s = np.cos(angle), np.sin(angle)
        squared = c * c * xx + 2.0 * c * s * xy + s * s * yy
        most = max(float(np.quantile(squared, 0.9)), 1e-6)
        for band in range(len(BANDS)):
            albedo, slope, error = _regress(
                c * x + s * y, squared, energy[:, band, direction], linear
            )
            found[:, band, direction] = albedo, slope, error, STRENGTH.uneven * albedo / most
    return found


def slope_strengths(height: NDArray[np.float32]) -> Doubles:
    """(len(BANDS), DIRECTIONS) the same strengths of a known height (H, W) in texels."""
    window = _hann()
    power = float(np.square(window).sum())
    across = np.gradient(height, axis=1)
    up = -np.gradient(height, axis=0)
    total = np.zeros_like(window)
    count = 0
    for cut in _windows(height.shape):
        waves = [np.fft.fft2((s[cut] - s[cut].mean()) * window) for s in (across, up)]
        total += sum(np.square(np.abs(w)) for w in waves)
        count += 1
    return np.sqrt(_sums(total, _kinds()) / power / window.size / max(1, count))


def _hann() -> Doubles:
    hann = np.hanning(STRENGTH.window)
    return np.asarray(hann[:, None] * hann, np.float64)


def _windows(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    side, stride = STRENGTH.window, STRENGTH.stride
    rows = range(0, shape[0] - side + 1, stride)
    columns = range(0, shape[1] - side + 1, stride)
    return [(slice(y, y + side), slice(x, x + side)) for y in rows for x in columns]


def _sums(spectrum: Doubles, kinds: NDArray[np.int64]) -> Doubles:
    """(len(BANDS), DIRECTIONS) of a spectrum (window, window)."""
    sums = np.bincount(kinds.ravel(), spectrum.ravel(), len(BANDS) * DIRECTIONS + 1)
    return np.asarray(sums[:-1].reshape(len(BANDS), DIRECTIONS), np.float64)


def _kinds() -> NDArray[np.int64]:
    """(window, window) DIRECTIONS * band + direction of every wave, y upwards; last: none.

    Both halves of the plane have the same.
    """
    frequency = np.fft.fftfreq(STRENGTH.window)
    fx, fy = np.meshgrid(frequency, -frequency)
    radius, angle = np.hypot(fx, fy), np.arctan2(fy, fx)
    direction = np.rint(angle / (np.pi / DIRECTIONS)).astype(np.int64) % DIRECTIONS
    kinds = np.full(radius.shape, len(BANDS) * DIRECTIONS)
    for band, (longest, shortest) in enumerate(BANDS):
        inside = (radius >= 1.0 / longest) & (radius < 1.0 / shortest)
        kinds[inside] = DIRECTIONS * band + direction[inside]
    return kinds


def _regress(
    slant: Doubles, squared: Doubles, energy: Doubles, counts: Doubles
) -> tuple[float, float, float]:
    """A, S and S's standard error, A and S not negative, by weighted least squares.

    Args:
        slant: (N,) of windows.
        squared: (N,) mean of its square.
        energy: (N,) theirs.
        counts: (N,) what each counts for, at most 1.
    """
    columns = np.stack([np.ones_like(slant), 2.0 * slant, squared], axis=1)
    own = np.sqrt(counts)
    weight, solution = own, np.zeros(3)
    for _ in range(STRENGTH.rounds):
        solution = np.linalg.lstsq(columns * weight[:, None], energy * weight, rcond=None)[0]
        solution[[0, 2]] = solution[[0, 2]].clip(0.0)
        weight = own / np.maximum(columns @ solution, 0.2 * energy.mean() + 1e-12)
    weighted = columns * weight[:, None]
    rest = np.square((energy - columns @ solution) * weight).sum()
    scatter = rest / max(float(counts.sum()) - 3.0, 1.0)
    inverse = np.linalg.pinv(weighted.T @ weighted)
    error = STRENGTH.scatter * float(np.sqrt(scatter * max(inverse[2, 2], 0.0)))
    return float(solution[0]), float(solution[2]), error
