"""Height from slopes by their precision, and Wiener estimates octave by octave."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.heights import integrate, poisson
from matcap.capture.exemplar.octaves import BANDS, smoothed, split, split_all
from matcap.capture.multiview.texels import slopes_of
from matcap.flash.least_squares import conjugate_gradients

Floats = NDArray[np.float32]
Changes = Sequence[Floats] | Floats  # (H, W) each

# Settings of the integration of slopes to heights; docs/notes/several.md.
_MODEL = 0.03  # standard deviation of slopes due to model errors: shadows, parallax, bend
_STEPS = 4  # conjugate gradient steps; more restore shorter wavelengths, and their noise
_EVEN = 4.0  # standard deviation of the smoothing of precision in the preconditioner, texels
_LEAST_PRECISION = 1e-3  # least precision of a slope, as a share of the mean


def surface_of(slopes: Tensor, texel_size: float, precision: Tensor) -> Tensor:
    """(1, H, W) height, plane units, whose central slopes are nearest to slopes (2, H, W).

    Minimises the sum over texels of e^T P e, e being the slope error (2,), by conjugate gradients
    with a Poisson preconditioner. Two photographs hardly measure slopes perpendicular to their
    baseline; the other slope then determines them, as a gradient has no curl.

    Args:
        slopes: along x and y.
        texel_size: in plane units.
        precision: (3, H, W) elements xx, yy and xy of P, to which _MODEL adds an independent error.
    """
    xx, yy, xy = precision * _MODEL**2
    determinant = xx * yy - xy * xy
    weight = torch.stack([xx + determinant, yy + determinant, xy])
    weight /= (1.0 + xx + yy + determinant).clamp_min(1e-12)
    weight /= weight[:2].mean().clamp_min(1e-12)
    weight[:2] += _LEAST_PRECISION

    def weighted(error: Tensor) -> Tensor:
        x, y = error
        return torch.stack([weight[0] * x + weight[2] * y, weight[1] * y + weight[2] * x])

    def gradient(of: Callable[[Tensor], Tensor], heights: Floats) -> Floats:
        """The transpose of the differences, applied to `of` the slopes of heights in texels."""
        differences, transposed = torch.func.vjp(_differences, torch.from_numpy(heights))[:2]
        return np.asarray(transposed(of(differences))[0].numpy(), np.float32)

    height = integrated(slopes, texel_size, 2)
    begun = (height[0] / texel_size).numpy()
    change = conjugate_gradients(
        lambda heights: gradient(weighted, heights),
        gradient(lambda differences: weighted(slopes - differences), begun),
        _STEPS,
        preconditioned=_preconditioner(weight[:2].numpy()),
    )
    return height + texel_size * torch.from_numpy(change)[None]


def _differences(heights: Tensor) -> Tensor:
    """(2, H, W) central differences of heights (H, W) in texels: slopes_of, as a linear map."""
    down, across = torch.gradient(heights)
    return torch.stack([across, -down])


def _preconditioner(weight: Floats) -> Callable[[Floats], Floats]:
    """The inverse Laplacian, locally scaled by the smoothed weight (2, H, W)."""
    shape, (across, down) = weight.shape[1:], weight.mean((1, 2)).tolist()
    local = cv2.GaussianBlur(weight[0] / across + weight[1] / down, (0, 0), _EVEN)
    scale = np.asarray(1.0 / np.sqrt(0.5 * local), np.float32)

    def preconditioned(residual: Floats) -> Floats:
        even = np.pad(residual * scale, [(0, side % 2) for side in shape])
        heights = poisson(even, across, down)[: shape[0], : shape[1]]
        return np.asarray(-heights * scale, np.float32)

    return preconditioned


def integrated(slopes: Tensor, texel_size: float, rounds: int = 4) -> Tensor:
    """(1, H, W) height nearest to slopes (2, H, W) of equal precision, plane units.

    By repeated Poisson integration of the residual slopes. A difference between neighbours is the
    mean of their slopes, so central differences of the height are smoother than the slopes; the
    rounds restore the loss.
    """
    height = torch.zeros(1, *slopes.shape[1:])
    for _ in range(rounds):
        x, y = ((slopes - slopes_of(height, texel_size)) * texel_size).numpy()
        across, down = 0.5 * (x[:, 1:] + x[:, :-1]), -0.5 * (y[1:] + y[:-1])
        height = height + torch.from_numpy(integrate(across, down))[None]
    return height


# Wiener estimate of a map, octave by octave, from its measurement and the network's prediction.
#
# In an octave let y be the map estimated from photographs, with noise of variance nu, and m the
# network's prediction. The truth is modelled as g m + e with e of variance T, so
#
# y = g m + e + noise,    g = E[y m] / E[m^2],    T = E[(y - g m)^2] - nu.
#
# nu is the variance of the change of y when each photograph is left out in turn: the jackknife
# [efron1982], which needs no model of misregistration, shadows or JPEG. m contains noise of the
# first photograph, so g is estimated from y without that photograph. The posterior mean g m + T /
# (T + nu) (y - g m) is too smooth; with the square root of the gain T / (T + nu) the octave has its
# expected energy g^2 E[m^2] + T.

_OCTAVES = ((256.0, 128.0), (128.0, 64.0), *BANDS)
_AROUND = 2.0  # wavelengths over which noise is averaged
_LEAST_VARIANCE = 1e-12  # lower limit of variances
_FINE = 4.0  # wavelength in texels up to which noise may be more than the jackknife says
_SCALED = 0.6, 1.5  # limits of the factor of an octave that is brought to its expected energy


class _Octave(NamedTuple):
    """What an octave band of a map turns out to be, in the symbols above."""

    posterior: Floats
    """(H, W) g m + sqrt(T / (T + nu)) (y - g m)."""
    error: float
    """Error variance of the prediction, T + max(g - 1, 0)^2 E[m^2]."""
    energy: float
    """Mean of the measured energy g^2 E[m^2] + T and the predicted, by their uncertainties."""


def denoised(
    measured: Floats, predicted: Floats, changes: Changes, *, understated: float = 1.0
) -> Floats:
    """(H, W) denoised map, each octave with its expected energy.

    Args:
        measured: (H, W) estimate from all photographs.
        predicted: (H, W) the network's prediction.
        changes: (H, W) each, change of `measured` when one photograph is left out.
        understated: variance of noise below 4 texels over what these changes say.
    """
    bands = (octave.posterior for octave in _octaves(measured, predicted, changes, understated))
    return np.asarray(sum(bands), np.float32)


def prediction_error(
    measured: Floats, predicted: Floats, changes: Changes
) -> tuple[float, NDArray[np.float64]]:
    """Error variance of the prediction, and expected energies of the octaves above 4 texels.

    Arguments as of denoised.
    """
    octaves = list(_octaves(measured, predicted, changes))
    long = [one for one, (_, shortest) in zip(octaves, _OCTAVES, strict=False) if shortest >= 4]
    return sum(octave.error for octave in octaves), np.array([octave.energy for octave in long])


def cross_energies(one: Floats, other: Floats, texel_size: float) -> list[float]:
    """Mean products of the slopes of two independently measured heights (H, W), by octave.

    Noise of either does not add to them: the cross-spectrum of both.
    """
    bands = list(split_all([one, other], _OCTAVES))[: len(_OCTAVES)]
    each = ([_differences(torch.from_numpy(half)) for half in pair] for pair in bands)
    return [float((one * other).mean()) / texel_size**2 for one, other in each]


def with_energies(height: Floats, texel_size: float, energies: Sequence[float]) -> Floats:
    """(H, W) height whose slopes have given mean energies in the longest of its octaves."""
    bands = split(height, _OCTAVES)
    for band, energy in zip(bands, energies, strict=False):
        current = float(_differences(torch.from_numpy(band)).square().mean()) / texel_size**2
        share = max(energy, 0.0) / max(current, _LEAST_VARIANCE)
        band *= np.float32(np.sqrt(share).clip(*_SCALED))
    return np.asarray(np.sum(bands, axis=0), np.float32)


def _octaves(
    measured: Floats, predicted: Floats, changes: Changes, understated: float = 1.0
) -> Iterator[_Octave]:
    """Octave bands of both maps and the low-pass remainder, with estimates of g and T."""
    # (n - 1) / n of the jackknife, but not 0 for one photograph
    jackknife = np.float32(max(0.5, 1.0 - 1.0 / len(changes)))
    waves = [*(longest for longest, _ in _OCTAVES), 2.0 * _OCTAVES[0][0]]
    bands = split_all([measured, predicted, *changes], _OCTAVES)
    for wave, (y, m, *changed) in zip(waves, bands, strict=True):
        noise = np.full_like(measured, _LEAST_VARIANCE)
        for change in changed:
            noise += jackknife * np.square(change)
        noise *= np.float32(understated if wave <= _FINE else 1.0)
        noise = smoothed(noise, _AROUND * wave)
        weight = 1.0 / noise
        # g has the prior 1 +- 1, and is never negative.
        few = float((weight * noise).mean()) / (y.size / wave**2)
        without_first = float((weight * (y + changed[0]) * m).mean())
        gain = max(without_first + few, 0.0) / (float((weight * m * m).mean()) + few)
        left = y - np.float32(gain) * m
        error = max(float((weight * (left * left - noise)).sum() / weight.sum()), _LEAST_VARIANCE)
        kept = np.sqrt(np.float32(error) / (np.float32(error) + noise))
        strong, uncertain = float(np.square(m).mean()), float(noise.mean())
        share = strong**2 / (strong**2 + uncertain**2 + _LEAST_VARIANCE**2)
        yield _Octave(
            np.float32(gain) * m + kept * left,
            error + max(gain - 1.0, 0.0) ** 2 * strong,
            share * (gain**2 * strong + error) + (1.0 - share) * strong,
        )
