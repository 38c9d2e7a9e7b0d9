"""Encoder inputs besides the image: parameters of the coarse fit, and texture statistics.

The encoder's image is too small to show fine texture. Autocorrelation, contrast and quantiles of
windows at full resolution describe it.
"""

from __future__ import annotations

import itertools
import math

import torch
from torch import Tensor

from matcap.flash.coarse.fit import CoarseFit
from matcap.space.encoder import NUMBERS
from matcap.statistics.compare import Descriptor, describe
from matcap.statistics.encoding import fit_encoding
from matcap.statistics.filterbank import FilterBank, FilterBankConfig

FEATURES = FilterBankConfig(sizes=(5,), filters=64)  # of the texture loss in training
# Gram matrices are no inputs of the encoder; one filter keeps them small.
_ENCODER_BANK = FilterBankConfig(sizes=(5,), filters=1, crossed=False)
WINDOW = 96  # texels a side of the windows that statistics are computed of
_PLACES_ACROSS, _PLACES_DOWN = (0.1, 0.37, 0.63, 0.9), (0.15, 0.5, 0.85)
_LEVELS = 3  # pyramid levels, as many as a window of 64 texels has
_LAGS_DOWN = (0, 1, 2, 4, 7, 11)  # texels of a level, as are those across
_LAGS_ACROSS = (-11, -7, -4, -2, -1, 0, 1, 2, 4, 7, 11)
_QUANTILES = (1, 5, 12, 24, 39, 51, 58, 62)  # indices of 64
_STRONGEST = 2  # index of the encoded channel of most variance


def numbers(coarse: CoarseFit, contrast: Tensor, detail: int) -> Tensor:
    """(NUMBERS,) parameters of the coarse fit, each about standard normal.

    Args:
        contrast: (3,) from tuning.start.log_contrast.
        detail: texels across the photograph.
    """
    setup = coarse.setup
    values = [
        *(math.log(value) + 1.5 for value in coarse.diffuse),
        math.log(coarse.specular) + 3.0,
        4.0 * (coarse.roughness - 0.5),
        *(math.log(max(float(value), 1e-3)) + 2.0 for value in contrast),
        (setup.fov - 60.0) / 15.0,
        10.0 * setup.offset[0],
        10.0 * setup.offset[1],
        10.0 * setup.tilt[0],
        10.0 * setup.tilt[1],
        # The prior was trained with fits of r^2 alone, whose coefficient takes 0.7 of that of r^4.
        2.0 * (setup.vignetting + 0.7 * setup.vignetting_quartic),
        10.0 * coarse.residual,
        math.log2(detail / 1024.0),
    ]
    assert len(values) == NUMBERS
    return torch.tensor(values, dtype=torch.float32)


def texture(windows: Descriptor) -> Tensor:
    """(TEXTURE,) means over windows of autocorrelation, log variance and quantiles by level."""
    parts = []
    levels = zip(windows.spectra, windows.quantiles, strict=True)
    for spectra, quantiles in itertools.islice(levels, _LEVELS):
        reach = spectra.shape[-1] // 2
        variance = spectra[:, :, 0, reach].clamp_min(1e-4)
        rows = spectra[:, _STRONGEST][:, [min(lag, reach) for lag in _LAGS_DOWN]]
        columns = [reach + max(-reach, min(lag, reach)) for lag in _LAGS_ACROSS]
        strongest = variance[:, _STRONGEST]
        parts.append((rows[:, :, columns] / strongest[:, None, None]).flatten(1))
        parts.append(0.5 * variance.log())
        parts.append(quantiles[:, _STRONGEST][:, list(_QUANTILES)] / strongest.sqrt()[:, None])
    return torch.cat(parts, dim=1).float().mean(0).clamp(-4.0, 4.0)


def describe_windows(linear: Tensor, valid: Tensor) -> Descriptor:
    """Descriptor of windows on a 4 x 3 grid over a rectified photograph.

    Windows are WINDOW texels wide, or as wide as a smaller photograph; those of which less than
    half is valid are left out, unless all are.

    Args:
        linear: (3, H, W) radiance.
        valid: (H, W) bool.
    """
    height, width = linear.shape[-2:]
    side = min(WINDOW, height, width)
    corners = [
        (round(x * (width - side)), round(y * (height - side)))
        for y in _PLACES_DOWN
        for x in _PLACES_ACROSS
    ]
    shares = [float(valid[y : y + side, x : x + side].float().mean()) for x, y in corners]
    least = min(0.5, max(shares))
    windows = [
        linear[:, y : y + side, x : x + side]
        for (x, y), share in zip(corners, shares, strict=True)
        if share >= least
    ]
    return describe(torch.stack(windows), fit_encoding(linear, valid), FilterBank(_ENCODER_BANK))
