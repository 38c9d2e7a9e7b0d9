"""What one flash photograph says outright of relief's and albedo's strength, in closed form.

To first order the logarithm of radiance is log albedo + g . grad h, where g is how log radiance
changes with slope (inputs.py): nothing under the flash's foot, more the further the light slants,
more again where gloss shows. A stationary sample has the same spectra everywhere, so in a window
whose mean g along a direction is s, the energy of the band's waves in that direction is

    E(s) = A + 2 C s + S s^2,

A albedo's energy, S the slopes', C how both go together. Windows differ in s, and a regression
over them recovers A and S.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Waves of these lengths in texels, longest and shortest of each band.
BANDS = ((64.0, 32.0), (32.0, 16.0), (16.0, 8.0), (8.0, 4.0), (4.0, 2.8), (2.8, 2.0))
DIRECTIONS = 6
_WINDOW, _STRIDE = 128, 64  # texels
_SEEN = 0.98  # share of a window that must be valid
_LINEAR = 1.2  # of g: beyond, radiance is far from linear in slope
_ROUNDS = 4  # of reweighting: energies scatter in proportion to themselves
_FEWEST = 8  # windows, for three unknowns


@dataclass(frozen=True)
class Strengths:
    """Root-mean-square strengths per band and direction, (len(BANDS), DIRECTIONS) each.

    Attributes:
        albedo: of log albedo.
        slope: of the slope along the direction.
        trust: how far the slope's strength stands out of its own scatter, 0 to 1.
    """

    albedo: Array
    slope: Array
    trust: Array

    @property
    def relief(self) -> float:
        """Root-mean-square slope of all bands and directions together."""
        return float(np.sqrt(np.square(self.slope).sum()))

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

    def lines(self) -> list[tuple[str, str]]:
        """Names, and a sentence each."""
        bands = self.document()["bands"]

        def sentence(what: str, strength: float, of: str) -> str:
            shares = (f"{b[of]:.3f} ({b['waves'][0]:g}-{b['waves'][1]:g})" for b in bands)
            return f"{what} {strength:.2f}; by waves in pixels: {', '.join(shares)}."

        contrast = float(np.sqrt(np.square(self.albedo).sum()))
        return [
            ("relief", sentence("Root-mean-square slope", self.relief, "slope")),
            ("albedo", sentence("Contrast of log albedo", contrast, "albedo")),
        ]


def measure_strengths(
    log: NDArray[np.float32],
    shows: NDArray[np.float32],
    use: NDArray[np.bool_],
    noise: float = 0.0,
) -> Strengths | None:
    """Strengths of a photograph; None where too little of it can be used.

    Args:
        log: (H, W) log radiance over the coarse fit's.
        shows: (2, H, W) change of log radiance with slope along x and y (upwards).
        use: (H, W) bool: seen, not clipped.
        noise: standard deviation of log radiance that is the sensor's.
    """
    window = np.hanning(_WINDOW)[:, None] * np.hanning(_WINDOW)
    power = float(np.square(window).sum())
    kinds = _kinds()
    energies, slants = [], []
    for cut in _windows(log.shape):
        if use[cut].mean() < _SEEN:
            continue
        g = shows[(slice(None), *cut)].mean((1, 2))
        if np.hypot(*g) > _LINEAR:
            continue
        flat = log[cut] - log[cut].mean()
        spectrum = np.square(np.abs(np.fft.fft2(flat * window))) / power / flat.size
        energies.append(_sums(spectrum, kinds))
        angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
        slants.append(g[0] * np.cos(angles) + g[1] * np.sin(angles))
    if len(energies) < _FEWEST:
        return None
    energy, slant = np.array(energies), np.array(slants)
    found = np.zeros((3, len(BANDS), DIRECTIONS))
    white = noise**2 * _sums(np.ones_like(window), kinds) / window.size
    for band in range(len(BANDS)):
        for direction in range(DIRECTIONS):
            found[:, band, direction] = _regress(
                slant[:, direction],
                np.maximum(energy[:, band, direction] - white[band, direction], 0.0),
            )
    albedo, slope, error = found
    return Strengths(
        albedo=np.sqrt(albedo),
        slope=np.sqrt(slope),
        trust=np.square(slope) / (np.square(slope) + np.square(error) + 1e-12),
    )


def slope_strengths(height: NDArray[np.float32]) -> Array:
    """(len(BANDS), DIRECTIONS) the same strengths of a known height (H, W) in texels."""
    window = np.hanning(_WINDOW)[:, None] * np.hanning(_WINDOW)
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


def _windows(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    rows = range(0, shape[0] - _WINDOW + 1, _STRIDE)
    columns = range(0, shape[1] - _WINDOW + 1, _STRIDE)
    return [(slice(y, y + _WINDOW), slice(x, x + _WINDOW)) for y in rows for x in columns]


def _sums(spectrum: Array, kinds: NDArray[np.int64]) -> Array:
    """(len(BANDS), DIRECTIONS) of a spectrum (_WINDOW, _WINDOW)."""
    sums = np.bincount(kinds.ravel(), spectrum.ravel(), len(BANDS) * DIRECTIONS + 1)
    return np.asarray(sums[:-1].reshape(len(BANDS), DIRECTIONS), np.float64)


def _kinds() -> NDArray[np.int64]:
    """(_WINDOW, _WINDOW) DIRECTIONS * band + direction of every wave, y upwards; last: none.

    Both halves of the plane have the same.
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


def _regress(slant: Array, energy: Array) -> tuple[float, float, float]:
    """A, S and S's standard error, A and S not negative, by weighted least squares."""
    columns = np.stack([np.ones_like(slant), 2.0 * slant, np.square(slant)], axis=1)
    weight: NDArray[Any] = np.ones_like(slant)
    solution: NDArray[Any] = np.zeros(3)
    for _ in range(_ROUNDS):
        solution = np.linalg.lstsq(columns * weight[:, None], energy * weight, rcond=None)[0]
        solution[[0, 2]] = solution[[0, 2]].clip(0.0)
        expected = columns @ solution
        weight = 1.0 / np.maximum(expected, 0.2 * energy.mean() + 1e-12)
    weighted = columns * weight[:, None]
    scatter = np.square((energy - columns @ solution) * weight).sum() / (len(slant) - 3)
    inverse = np.linalg.pinv(weighted.T @ weighted)
    error = float(np.sqrt(scatter * max(inverse[2, 2], 0.0)))
    return float(solution[0]), float(solution[2]), error
