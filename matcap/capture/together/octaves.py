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

from matcap.capture.piece.smooth import smoothed, split, split_all
from matcap.capture.piece.strengths import BANDS
from matcap.capture.together.surface import texel_slopes

Floats = NDArray[np.float32]

_OCTAVES = ((256.0, 128.0), (128.0, 64.0), *BANDS)
_AROUND = 2.0  # wavelengths over which noise is averaged
_LEAST = 1e-12  # lower limit of variances
_SCALED = 0.6, 1.5  # limits of the factor of an octave that is brought to its expected energy


@dataclass(frozen=True)
class _Octave:
    """An octave band of a map, in the module's symbols.

    Attributes:
        measured, read: (H, W) y and m.
        noise: (H, W) nu.
        gain, error: g and T.
    """

    measured: Floats
    read: Floats
    noise: Floats
    gain: np.float32
    error: np.float32

    @staticmethod
    def of(measured: Floats, others: Floats, read: Floats, noise: Floats, wave: float) -> _Octave:
        """Estimate g and T; `others`: without the first photograph, `wave`: longest, texels."""
        weight = 1.0 / noise
        # g has the prior 1 +- 1, and is never negative.
        count = measured.size / wave**2
        few = float((weight * noise).mean()) / count
        gain = max(float((weight * others * read).mean()) + few, 0.0) / (
            float((weight * read * read).mean()) + few
        )
        left = np.square(measured - np.float32(gain) * read) - noise
        error = max(float((weight * left).sum() / weight.sum()), _LEAST)
        return _Octave(measured, read, noise, np.float32(gain), np.float32(error))

    def posterior(self, gain: np.float32) -> Floats:
        """(H, W) gain m + sqrt(T / (T + nu)) (y - g m)."""
        kept = np.sqrt(self.error / (self.error + self.noise), dtype=np.float32)
        return gain * self.read + kept * (self.measured - self.gain * self.read)

    @property
    def energy(self) -> float:
        """Mean of the measured and the predicted energy, by their uncertainties."""
        read, noise = float(np.square(self.read).mean()), float(self.noise.mean())
        seen = float(self.gain) ** 2 * read + float(self.error)
        sure = read**2 / (read**2 + noise**2 + _LEAST**2)
        return sure * seen + (1.0 - sure) * read

    def drawn(self) -> np.float32:
        """Gain of the network's prediction at which the octave has its expected energy."""
        read = max(float(np.square(self.read).mean()), _LEAST)
        more = (self.energy - float(self.error)) / read
        return np.float32(max(abs(float(self.gain)), np.sqrt(max(more, 0.0))))


def denoised(
    measured: Floats, read: Floats, changes: Sequence[Floats] | Floats, *, drawn: bool = False
) -> Floats:
    """(H, W) denoised map, each octave with its expected energy.

    Args:
        measured: (H, W) estimate from all photographs.
        read: (H, W) the network's prediction.
        changes: (H, W) each, change of `measured` when one photograph is left out.
        drawn: use _Octave.drawn as the gain of `read`, not g: energy that noise hides is then kept.
    """
    bands = [o.posterior(o.drawn() if drawn else o.gain) for o in _octaves(measured, read, changes)]
    return np.asarray(np.sum(bands, axis=0), np.float32)


def read_error(
    measured: Floats, read: Floats, changes: Sequence[Floats] | Floats
) -> tuple[float, NDArray[np.float64]]:
    """Error variance of the prediction, and expected energies of the octaves above 4 texels.

    The former is the sum over octaves of T + max(g - 1, 0)^2 E[m^2]. Arguments as of denoised.
    """
    octaves = list(_octaves(measured, read, changes))
    more = (max(float(o.gain) - 1.0, 0.0) ** 2 * float(np.square(o.read).mean()) for o in octaves)
    error = sum(float(o.error) for o in octaves) + sum(more)
    energies = [
        o.energy for o, (_, shortest) in zip(octaves, _OCTAVES, strict=False) if shortest >= 4
    ]
    return error, np.array(energies)


def with_energies(height: Floats, texel_size: float, energies: Sequence[float]) -> Floats:
    """(H, W) height whose slopes have given mean energies in the longest of its octaves."""
    bands = split(height, _OCTAVES)
    for band, energy in zip(bands, energies, strict=False):
        now = float(np.square(texel_slopes(band)).mean()) / texel_size**2
        band *= np.float32(np.sqrt(energy / max(now, _LEAST)).clip(*_SCALED))
    return np.asarray(np.sum(bands, axis=0), np.float32)


def _octaves(
    measured: Floats, read: Floats, changes: Sequence[Floats] | Floats
) -> Iterator[_Octave]:
    """Octave bands of both maps, and the low-pass remainder."""
    # (n - 1) / n of the jackknife, but not 0 for one photograph
    share = np.float32(max(0.5, 1.0 - 1.0 / len(changes)))
    waves = [*(longest for longest, _ in _OCTAVES), 2.0 * _OCTAVES[0][0]]
    bands = split_all([measured, read, *changes], _OCTAVES)
    for wave, (y, m, *changed) in zip(waves, bands, strict=True):
        noise = np.full_like(measured, _LEAST)
        for change in changed:
            noise += share * np.square(change)
        yield _Octave.of(y, y + changed[0], m, smoothed(noise, _AROUND * wave), wave)
