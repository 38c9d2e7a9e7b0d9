"""Power spectra of image windows, and autocorrelations.

Spectra describe regular structure, which Gram matrices do not [liu2016] [henzler2021, sec. 4.3].
The autocorrelation is the inverse Fourier transform of the power spectrum (Wiener-Khinchin);
truncating it at a lag smooths the spectrum, which reduces the noise of a single window's estimate.
"""

from __future__ import annotations

import torch
from torch import Tensor


def power_spectrum(image: Tensor) -> Tensor:
    """(B, C, H, W // 2 + 1) power of (B, C, H, W) less its mean, under a Hann window.

    White noise of unit variance has unit expected power at every frequency.
    """
    height, width = image.shape[-2:]
    window = _hann(height, image)[:, None] * _hann(width, image)
    centred = image - image.mean(dim=(-2, -1), keepdim=True)
    return torch.fft.rfft2(centred * window).abs().square() / window.square().sum()


def autocorrelation(image: Tensor, lags: int) -> Tensor:
    """(B, C, lags + 1, 2 lags + 1) autocovariance of (B, C, H, W).

    Row r, column lags + c holds lag (r, c) in texels; the other half plane is its mirror image. Lag
    (0, 0) is the variance. The Hann window attenuates each lag, equally for all images of a size.
    """
    height, width = image.shape[-2:]
    correlation = torch.fft.irfft2(power_spectrum(image), s=(height, width))
    rows = correlation[..., : lags + 1, :]
    return torch.cat([rows[..., -lags:], rows[..., : lags + 1]], dim=-1)


def _hann(size: int, like: Tensor) -> Tensor:
    return torch.hann_window(size, periodic=True, dtype=like.dtype, device=like.device)
