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

# Tuned constants of the encoding; docs/notes/prior.md.

# Added inside the logarithm, as a share of the median radiance; it bounds the log of black.
_TOE = 0.05
# Lower limit of a colour direction's deviation, as a share of the strongest direction's.
_FAINTEST = 0.2
# Lower limit of the strongest direction's standard deviation, log radiance; below is noise.
_LEAST_CONTRAST = 0.02
_LEAST_SIGNAL = 0.05  # lower limit of the signal's share of a colour direction's variance
_LEAST_TEXELS = 64  # with fewer valid texels the covariance is taken over all texels
_SHADING_SCALE = 48  # texels: side of the box average that separates shading from texture
_MOST_TEXELS = 1024  # a side; of a larger picture every second texel is used, or fewer


@dataclass(frozen=True)
class Encoding:
    """Map from linear radiance to decorrelated log colours of about unit variance."""

    median: float
    """Radiance that is mapped to log 0."""
    matrix: Tensor
    """(3, 3) from log colour to decorrelated colour."""
    limit: float = 1.0
    """Radiance at which the photograph clips, and all that is compared with it."""

    def __call__(self, linear: Tensor) -> Tensor:
        """(B, 3, H, W) encoded colours of linear radiance (B, 3, H, W)."""
        return torch.einsum("ij,bjhw->bihw", self.matrix.to(linear), self.log(linear))

    def log(self, linear: Tensor) -> Tensor:
        """Logarithm ln((L / median + toe) / (1 + toe)) of radiance L (B, 3, H, W), clipped."""
        return torch.log((self.clipped(linear) / self.median + _TOE) / (1.0 + _TOE))

    def clipped(self, linear: Tensor) -> Tensor:
        """Radiance clipped as the photograph is."""
        return linear.clamp(0.0, self.limit)


def fit_encoding(
    linear: Tensor, valid: Tensor, noise: Tensor | None = None, limit: float = 1.0
) -> Encoding:
    """Fit the encoding of a photograph: whitening by the eigenvectors of its log colours.

    Args:
        linear: (3, H, W) scene-linear radiance.
        valid: (H, W) bool, texels inside the photograph and not clipped; all texels are used where
            fewer than _LEAST_TEXELS are valid.
        noise: (3, H, W) an independent sample of the photograph's noise; each colour direction is
            scaled by the square root of its signal's share of the variance.
        limit: radiance at which the photograph clips.
    """
    step = -(-max(linear.shape[-2:]) // _MOST_TEXELS)
    if step > 1:
        linear, valid = linear[:, ::step, ::step], valid[::step, ::step]
        noise = None if noise is None else noise[:, ::step, ::step]
    if int(valid.sum()) < _LEAST_TEXELS:
        valid = torch.ones_like(valid)
    seen = linear[:, valid]
    median = max(float(seen.mean(0).median()), 1e-6)
    plain = Encoding(median, torch.eye(3), limit)
    log = plain.log(linear[None])
    texture = (log - shading(log, _SHADING_SCALE // step))[0][:, valid]
    values, vectors = torch.linalg.eigh(torch.cov(texture.double()))
    strongest = values[-1].clamp_min(_LEAST_CONTRAST**2)
    scale = torch.rsqrt(values.clamp_min(_FAINTEST**2 * strongest))
    if noise is not None:
        added = (plain.log((linear + noise)[None]) - log)[0][:, valid]
        noisy = (vectors * (torch.cov(added.double()) @ vectors)).sum(dim=0)
        scale = scale * (1.0 - noisy / values.clamp_min(1e-12)).clamp_min(_LEAST_SIGNAL).sqrt()
    return Encoding(median, (vectors * scale).T.float().contiguous(), limit)


def shading(image: Tensor, scale: int = _SHADING_SCALE) -> Tensor:
    """(B, C, H, W) smooth part of an image: box averages of `scale` texels, upsampled."""
    size = min(scale, *image.shape[-2:])
    small = F.avg_pool2d(image, size, stride=max(1, size // 2))
    return F.interpolate(small, size=image.shape[-2:], mode="bilinear", align_corners=False)
