"""The colour space in which photographs are compared: decorrelated logarithms of radiance.

A logarithm turns shading times albedo into a sum, so a dark corner's texture weighs like a bright
middle's. Turning and scaling the colours by the photograph's own covariance (of what is left when
the smooth shading is taken off) puts faint and strong, grey and colourful textures on one scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor


@dataclass(frozen=True)
class EncodingSettings:
    """What is tuned of the colours textures are compared in; docs/notes/prior.md."""

    toe: float = 0.05
    """Of the photograph's median: radiances so far below it all look black."""
    faintest: float = 0.2
    """Colour directions fainter than this share of the strongest are not amplified further."""
    least_contrast: float = 0.02
    """Log: a texture of less is noise, and not amplified to full scale."""
    least_signal: float = 0.05
    """Share of a colour direction's variance that counts as signal at least."""
    least_texels: int = 64
    """Fewer have no covariance worth the name."""
    shading_scale: int = 48
    """Texels: what varies more slowly is shading, not texture."""


ENCODING = EncodingSettings()


@dataclass(frozen=True)
class Encoding:
    """Linear radiance (B, 3, H, W) to texture colour of about unit variance."""

    median: float
    """Radiance that counts as middle grey."""
    matrix: Tensor
    """(3, 3) from log colour to decorrelated colour."""

    def __call__(self, linear: Tensor) -> Tensor:
        """Encode; radiance above the clip level 1 counts as 1, like in the photograph."""
        return torch.einsum("ij,bjhw->bihw", self.matrix.to(linear), self.log(linear))

    def log(self, linear: Tensor) -> Tensor:
        """(B, 3, H, W) bounded logarithm of radiance: 0 at the median, slope bounded at 0."""
        return torch.log(
            (linear.clamp(0.0, 1.0) / self.median + ENCODING.toe) / (1.0 + ENCODING.toe)
        )


def fit_encoding(linear: Tensor, valid: Tensor, noise: Tensor | None = None) -> Encoding:
    """The encoding of a photograph.

    Args:
        linear: (3, H, W) scene-linear picture.
        valid: (H, W) bool, texels that were seen and not clipped; where there are hardly any, all
            are looked at.
        noise: (3, H, W) another draw of what the picture holds of it; colour directions that
            hold little else count for little.
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
    """What of an image (B, C, H, W) varies slower than texture does."""
    size = min(ENCODING.shading_scale, *image.shape[-2:])
    small = F.avg_pool2d(image, size, stride=max(1, size // 2))
    return F.interpolate(small, size=image.shape[-2:], mode="bilinear", align_corners=False)
