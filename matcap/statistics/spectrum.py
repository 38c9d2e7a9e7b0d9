"""Power spectra of image windows, and their inverse transform, autocorrelations.

Gram matrices do not see order: a spectrum does (Liu et al. 2016; paper, section 4.3). By the
Wiener-Khinchin theorem the autocorrelation is the spectrum's Fourier transform, so comparing
autocorrelations out to a lag compares spectra smoothed to the resolution that lag allows, which
keeps the noise of a single window out of the comparison.
"""

from __future__ import annotations

import torch
from torch import Tensor


def power_spectrum(image: Tensor) -> Tensor:
    """(B, C, H, W // 2 + 1) power of (B, C, H, W) under a Hann window, mean taken off.

    Scaled so that white noise of unit variance has unit power at every frequency.
    """
    height, width = image.shape[-2:]
    window = _hann(height, image)[:, None] * _hann(width, image)
    centred = image - image.mean(dim=(-2, -1), keepdim=True)
    return torch.fft.rfft2(centred * window).abs().square() / window.square().sum()


def autocorrelation(image: Tensor, reach: int) -> Tensor:
    """(B, C, reach + 1, 2 reach + 1) covariance of (B, C, H, W) with itself at every lag.

    Row r, column reach + c: lag (r, c) texels; the other half plane is the mirror image. Lag
    (0, 0) is the variance. Biased by the Hann window alone, equally for all images of a size.
    """
    height, width = image.shape[-2:]
    correlation = torch.fft.irfft2(power_spectrum(image), s=(height, width))
    rows = correlation[..., : reach + 1, :]
    return torch.cat([rows[..., -reach:], rows[..., : reach + 1]], dim=-1)


def _hann(size: int, like: Tensor) -> Tensor:
    return torch.hann_window(size, periodic=True, dtype=like.dtype, device=like.device)
