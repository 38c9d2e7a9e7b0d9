"""The colour space in which photographs are compared: decorrelated logarithms of radiance.

The logarithm turns the product of shading and albedo into a sum, so that texture has the same
contrast in a dark corner as in the bright middle. The log colours are then whitened, approximately,
by their covariance after the smooth shading is subtracted, so that the descriptors of faint,
strong, grey and colourful textures have about the same scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor


@dataclass(frozen=True)
class EncodingSettings:
    """Tuned constants of the encoding; docs/notes/prior.md."""

    toe: float = 0.05
    """Added inside the logarithm, as a share of the median radiance; it bounds the log of black."""
    faintest: float = 0.2
    """Lower limit of a colour direction's deviation, as a share of the strongest direction's."""
    least_contrast: float = 0.02
    """Lower limit of the strongest direction's standard deviation, log radiance; below is noise."""
    least_signal: float = 0.05
    """Lower limit of the signal's share of a colour direction's variance."""
    least_texels: int = 64
    """With fewer valid texels the covariance is taken over all texels."""
    shading_scale: int = 48
    """Texels: side of the box average that separates shading from texture."""


ENCODING = EncodingSettings()


@dataclass(frozen=True)
class Encoding:
    """Map from linear radiance to decorrelated log colours of about unit variance."""

    median: float
    """Radiance that is mapped to log 0."""
    matrix: Tensor
    """(3, 3) from log colour to decorrelated colour."""

    def __call__(self, linear: Tensor) -> Tensor:
        """(B, 3, H, W) encoded colours of linear radiance (B, 3, H, W)."""
        return torch.einsum("ij,bjhw->bihw", self.matrix.to(linear), self.log(linear))

    def log(self, linear: Tensor) -> Tensor:
        """Logarithm ln((L / median + toe) / (1 + toe)) of radiance L (B, 3, H, W) in [0, 1]."""
        return torch.log(
            (linear.clamp(0.0, 1.0) / self.median + ENCODING.toe) / (1.0 + ENCODING.toe)
        )


def fit_encoding(linear: Tensor, valid: Tensor, noise: Tensor | None = None) -> Encoding:
    """Fit the encoding of a photograph: whitening by the eigenvectors of its log colours.

    Args:
        linear: (3, H, W) scene-linear radiance.
        valid: (H, W) bool, texels inside the photograph and not clipped; all texels are used where
            fewer than ENCODING.least_texels are valid.
        noise: (3, H, W) an independent sample of the photograph's noise; each colour direction is
            scaled by the square root of its signal's share of the variance.
    """
    if int(valid.sum()) < ENCODING.least_texels:
        valid = torch.ones_like(valid)
    seen = linear[:, valid]
    median = max(float(seen.mean(0).median()), 1e-6)
    plain = Encoding(median, torch.eye(3))
    log = plain.log(linear[None])
    texture = (log - shading(log))[0][:, valid]
    values, vectors = torch.linalg.eigh(torch.cov(texture.double()))
    strongest = values[-1].clamp_min(ENCODING.least_contrast**2)
    scale = torch.rsqrt(values.clamp_min(ENCODING.faintest**2 * strongest))
    if noise is not None:
        added = (plain.log((linear + noise)[None]) - log)[0][:, valid]
        noisy = (vectors * (torch.cov(added.double()) @ vectors)).sum(dim=0)
        scale = (
            scale * (1.0 - noisy / values.clamp_min(1e-12)).clamp_min(ENCODING.least_signal).sqrt()
        )
    return Encoding(median, (vectors * scale).T.float().contiguous())


def shading(image: Tensor) -> Tensor:
    """(B, C, H, W) smooth part of an image: box averages of ENCODING.shading_scale, upsampled."""
    size = min(ENCODING.shading_scale, *image.shape[-2:])
    small = F.avg_pool2d(image, size, stride=max(1, size // 2))
    return F.interpolate(small, size=image.shape[-2:], mode="bilinear", align_corners=False)
