"""Wiener estimate of a map, octave by octave, from its measurement and the network's prediction.

In an octave let y be the map estimated from photographs, with noise of variance nu, and m the
network's prediction. The truth is modelled as g m + e with e of variance T, so

    y = g m + e + noise,    g = E[y m] / E[m^2],    T = E[(y - g m)^2] - nu.

nu is the variance of the change of y when each photograph is left out in turn: the jackknife
[efron1982], which needs no model of misregistration, shadows or JPEG. m contains noise of the first
photograph, so g is estimated from y without that photograph. The posterior mean
g m + T / (T + nu) (y - g m) is too smooth; with the square root of the gain T / (T + nu) the
octave has its expected energy g^2 E[m^2] + T.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.capture.exemplar.filters import BANDS, smoothed, split, split_all
from matcap.capture.multiview.surface import texel_slopes

Floats = NDArray[np.float32]

_OCTAVES = ((256.0, 128.0), (128.0, 64.0), *BANDS)
_AROUND = 2.0  # wavelengths over which noise is averaged
_LEAST = 1e-12  # lower limit of variances
_SCALED = 0.6, 1.5  # limits of the factor of an octave that is brought to its expected energy


@dataclass(frozen=True)
class _Octave:
    """An octave band of a map, in the module's symbols."""

    measured: Floats
    predicted: Floats
    """(H, W) y and m."""
    noise: Floats
    """(H, W) nu."""
    gain: np.float32
    error: np.float32
    """Symbols g and T of the module."""

    def posterior(self, gain: np.float32) -> Floats:
        """(H, W) gain m + sqrt(T / (T + nu)) (y - g m)."""
        kept = np.sqrt(self.error / (self.error + self.noise), dtype=np.float32)
        return gain * self.predicted + kept * (self.measured - self.gain * self.predicted)

    @property
    def energy(self) -> float:
        """Mean of the measured and the predicted energy, by their uncertainties."""
        predicted, noise = float(np.square(self.predicted).mean()), float(self.noise.mean())
        measured = float(self.gain) ** 2 * predicted + float(self.error)
        share = predicted**2 / (predicted**2 + noise**2 + _LEAST**2)
        return share * measured + (1.0 - share) * predicted

    def gain_by_energy(self) -> np.float32:
        """Gain of the network's prediction at which the octave has its expected energy."""
        predicted = max(float(np.square(self.predicted).mean()), _LEAST)
        more = (self.energy - float(self.error)) / predicted
        return np.float32(max(abs(float(self.gain)), np.sqrt(max(more, 0.0))))


def denoised(
    measured: Floats,
    predicted: Floats,
    changes: Sequence[Floats] | Floats,
    *,
    keep_energy: bool = False,
) -> Floats:
    """(H, W) denoised map, each octave with its expected energy.

    Args:
        measured: (H, W) estimate from all photographs.
        predicted: (H, W) the network's prediction.
        changes: (H, W) each, change of `measured` when one photograph is left out.
        keep_energy: use _Octave.gain_by_energy, not g, so that energy hidden by noise is kept.
    """
    octaves = _octaves(measured, predicted, changes)
    bands = [o.posterior(o.gain_by_energy() if keep_energy else o.gain) for o in octaves]
    return np.asarray(np.sum(bands, axis=0), np.float32)


def prediction_error(
    measured: Floats, predicted: Floats, changes: Sequence[Floats] | Floats
) -> tuple[float, NDArray[np.float64]]:
    """Error variance of the prediction, and expected energies of the octaves above 4 texels.

    The former is the sum over octaves of T + max(g - 1, 0)^2 E[m^2]. Arguments as of denoised.
    """
    octaves = list(_octaves(measured, predicted, changes))
    more = (
        max(float(o.gain) - 1.0, 0.0) ** 2 * float(np.square(o.predicted).mean()) for o in octaves
    )
    error = sum(float(o.error) for o in octaves) + sum(more)
    energies = [
        o.energy for o, (_, shortest) in zip(octaves, _OCTAVES, strict=False) if shortest >= 4
    ]
    return error, np.array(energies)


def with_energies(height: Floats, texel_size: float, energies: Sequence[float]) -> Floats:
    """(H, W) height whose slopes have given mean energies in the longest of its octaves."""
    bands = split(height, _OCTAVES)
    for band, energy in zip(bands, energies, strict=False):
        current = float(np.square(texel_slopes(band)).mean()) / texel_size**2
        band *= np.float32(np.sqrt(energy / max(current, _LEAST)).clip(*_SCALED))
    return np.asarray(np.sum(bands, axis=0), np.float32)


def _octaves(
    measured: Floats, predicted: Floats, changes: Sequence[Floats] | Floats
) -> Iterator[_Octave]:
    """Octave bands of both maps and the low-pass remainder, with estimates of g and T."""
    # (n - 1) / n of the jackknife, but not 0 for one photograph
    share = np.float32(max(0.5, 1.0 - 1.0 / len(changes)))
    waves = [*(longest for longest, _ in _OCTAVES), 2.0 * _OCTAVES[0][0]]
    bands = split_all([measured, predicted, *changes], _OCTAVES)
    for wave, (y, m, *changed) in zip(waves, bands, strict=True):
        noise = np.full_like(measured, _LEAST)
        for change in changed:
            noise += share * np.square(change)
        noise = smoothed(noise, _AROUND * wave)
        weight = 1.0 / noise
        # g has the prior 1 +- 1, and is never negative.
        few = float((weight * noise).mean()) / (y.size / wave**2)
        without_first = float((weight * (y + changed[0]) * m).mean())
        gain = max(without_first + few, 0.0) / (float((weight * m * m).mean()) + few)
        left = np.square(y - np.float32(gain) * m) - noise
        error = max(float((weight * left).sum() / weight.sum()), _LEAST)
        yield _Octave(y, m, noise, np.float32(gain), np.float32(error))
