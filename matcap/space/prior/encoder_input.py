"""Encoder input of a photograph: a small picture, the coarse fit, and texture statistics.

The small picture shows the highlight and large patterns; fine texture is lost in it, so statistics
of windows at full detail go with it (autocorrelation, contrast and distribution, per level).
"""

from __future__ import annotations

import itertools
import math

import torch
from torch import Tensor

from matcap.flash.coarse import CoarseFit
from matcap.space.encoder import NUMBERS
from matcap.statistics.compare import Descriptor, describe
from matcap.statistics.encoding import fit_encoding
from matcap.statistics.filterbank import FilterBank, FilterBankConfig

FEATURES = FilterBankConfig(sizes=(5,), filters=64)  # that windows are compared by in training
# The encoder's inputs are spectra and distributions; Gram matrices are not, and can be small.
_ENCODER_BANK = FilterBankConfig(sizes=(5,), filters=1, crossed=False)
WINDOW = 96  # texels a side of the windows whose texture statistics are input
_PLACES_ACROSS, _PLACES_DOWN = (0.1, 0.37, 0.63, 0.9), (0.15, 0.5, 0.85)
_LEVELS = 3  # of the pyramid; what a window of 64 texels has
_LAGS_DOWN = (0, 1, 2, 4, 7, 11)  # texels of a level, as are those across
_LAGS_ACROSS = (-11, -7, -4, -2, -1, 0, 1, 2, 4, 7, 11)
_QUANTILES = (1, 5, 12, 24, 39, 51, 58, 62)  # of 64
_STRONGEST = 2  # the encoding's channel of most variance


def numbers(coarse: CoarseFit, contrast: Tensor, detail: int) -> Tensor:
    """(NUMBERS,) the coarse fit, the photograph's contrast and detail, each about unit size."""
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
        # Priors were trained on fits with r^2 alone, which take so much of r^4 for it.
        2.0 * (setup.vignetting + 0.7 * setup.vignetting_quartic),
        10.0 * coarse.residual,
        math.log2(detail / 1024.0),
    ]
    assert len(values) == NUMBERS
    return torch.tensor(values, dtype=torch.float32)


def texture(windows: Descriptor) -> Tensor:
    """(TEXTURE,) the texture of windows of WINDOW texels, averaged over them."""
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
    """Descriptor of windows on a grid over a rectified photograph (3, H, W).

    They are of WINDOW texels, or as large as a smaller photograph allows.
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
