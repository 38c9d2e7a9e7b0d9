"""Descriptors of texture windows and the distance between them (paper, section 4.3).

A descriptor holds, per pyramid level, the Gram matrix of the features, their covariance with those
of the next coarser level, the autocorrelation of the colours and their quantiles; and the window's
mean colour. The distance is a weighted sum of L1 differences, each divided by the target's L1 norm,
so that no level and no statistic dominates.

Covariances between levels describe structure that spans scales, such as edges, which Gram matrices
of single levels do not [portilla2000].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from matcap.statistics.encoding import Encoding
from matcap.statistics.filterbank import pyramid
from matcap.statistics.gram import moments
from matcap.statistics.spectrum import autocorrelation

# Tuned constants of descriptors; docs/notes/prior.md.
_LAGS = 12  # largest lag of the autocorrelation, in texels of its pyramid level
QUANTILES = 64  # number of quantiles per colour channel
_LARGEST = 144  # texels: a larger pyramid level is cropped to a central square of this side


# Lower limit of the L1 norm that differences are divided by: a tenth of the least in photographs of
# textures. Without it the distance to a uniform photograph would divide by zero.
UNSEEN = 1e-3


class Features(Protocol):
    """Feature extractor: a FilterBank or a trained network (VGG-19)."""

    @property
    def levels(self) -> int:
        """Number of levels of the colour pyramid."""
        ...

    @property
    def crossed(self) -> bool:
        """Whether covariances between successive feature maps, each half as large, are used."""
        ...

    def maps(self, linear: Tensor, colours: Sequence[Tensor]) -> list[Tensor]:
        """Feature maps, each (B, C, h, w).

        Args:
            linear: (B, 3, H, W) scene-linear radiance.
            colours: pyramid of its encoded colours, finest first, (B, 3, h, w) each.
        """
        ...


@dataclass(frozen=True)
class Weights:
    """Weights of the statistics in distance()."""

    gram: float = 1.0
    cross: float = 1.0
    spectrum: float = 1.0
    histogram: float = 0.5
    mean: float = 1.0


@dataclass(frozen=True)
class Descriptor:
    """Statistics of B windows."""

    mean: Tensor
    """(B, 6) mean of the log colour, then log of the mean colour. At strong contrast the first is
    dominated by dark texels, the second by bright ones."""
    grams: tuple[Tensor, ...]
    """Per feature map (B, F + 1, F + 1); the last feature is the constant 1, so the last column
    holds the features' means."""
    crosses: tuple[Tensor, ...]
    """Per pair of successive feature maps (B, F, F) covariances."""
    spectra: tuple[Tensor, ...]
    """Per pyramid level (B, 3, lags + 1, 2 lags + 1) autocorrelations of the colours."""
    quantiles: tuple[Tensor, ...]
    """Per pyramid level (B, 3, Q) quantiles of the colours less their mean."""

    def select(self, index: Tensor | Sequence[int]) -> Descriptor:
        """Descriptors of the windows of these indices."""
        return Descriptor(
            self.mean[index],
            tuple(g[index] for g in self.grams),
            tuple(c[index] for c in self.crosses),
            tuple(s[index] for s in self.spectra),
            tuple(q[index] for q in self.quantiles),
        )

    @staticmethod
    def joined(parts: Sequence[Descriptor]) -> Descriptor:
        """Concatenation along the window axis."""
        return Descriptor(
            torch.cat([part.mean for part in parts]),
            tuple(torch.cat(level) for level in zip(*(p.grams for p in parts), strict=True)),
            tuple(torch.cat(level) for level in zip(*(p.crosses for p in parts), strict=True)),
            tuple(torch.cat(level) for level in zip(*(p.spectra for p in parts), strict=True)),
            tuple(torch.cat(level) for level in zip(*(p.quantiles for p in parts), strict=True)),
        )


def describe(linear: Tensor, encoding: Encoding, bank: Features) -> Descriptor:
    """Descriptor of scene-linear windows (B, 3, H, W)."""
    log = encoding.log(linear)
    colour = torch.einsum("ij,bjhw->bihw", encoding.matrix.to(log), log)
    levels = [_middle(level) for level in pyramid(colour, bank.levels)]
    features = bank.maps(linear, levels)
    grams, crosses = moments(features, crossed=bank.crossed)
    average = encoding.log(encoding.clipped(linear).mean(dim=(2, 3), keepdim=True))
    return Descriptor(
        mean=torch.cat([log.mean(dim=(2, 3)), average[..., 0, 0]], dim=1),
        grams=grams,
        crosses=crosses,
        spectra=tuple(
            autocorrelation(level, min(_LAGS, min(level.shape[-2:]) // 2 - 1)) for level in levels
        ),
        quantiles=tuple(_quantiles(level) for level in levels),
    )


def distance(sample: Descriptor, target: Descriptor, weights: Weights) -> Tensor:
    """(B,) weighted relative L1 distance: 0 for equal statistics, about 1 for unlike textures."""
    total = weights.mean * (sample.mean - target.mean).abs().mean(dim=1)
    for weight, ours, theirs in (
        (weights.gram, sample.grams, target.grams),
        (weights.cross, sample.crosses, target.crosses),
        (weights.spectrum, sample.spectra, target.spectra),
        (weights.histogram, sample.quantiles, target.quantiles),
    ):
        for one, other in zip(ours, theirs, strict=True):
            total = total + weight / len(theirs) * _relative(one, other)
    return total


def _middle(level: Tensor) -> Tensor:
    """Central crop of a pyramid level, at most _LARGEST texels a side, to save time."""
    height, width = level.shape[-2:]
    y, x = max(0, height - _LARGEST) // 2, max(0, width - _LARGEST) // 2
    return level[..., y : y + min(height, _LARGEST), x : x + min(width, _LARGEST)]


def _relative(sample: Tensor, target: Tensor) -> Tensor:
    """(B,) L1 norm of the difference over that of the target."""
    size = target.abs().flatten(1).mean(dim=1)
    return (sample - target).abs().flatten(1).mean(dim=1) / size.clamp_min(UNSEEN)


def _quantiles(level: Tensor) -> Tensor:
    """(B, 3, Q) evenly spaced quantiles of the colours less their mean."""
    flat = level.flatten(2)
    count = min(QUANTILES, flat.shape[2])
    chunk = flat.shape[2] // count
    centred = flat - flat.mean(dim=2, keepdim=True)
    ordered = centred.gather(2, _order(flat)) if flat.requires_grad else _sorted(centred)
    return ordered[..., : chunk * count].unflatten(2, (count, chunk)).mean(dim=3)


def _order(flat: Tensor) -> Tensor:
    """Sorting indices of (B, C, n) along n, by NumPy, which is five times as fast as torch."""
    numbers = flat.detach().cpu().contiguous()
    if numbers.dtype == torch.bfloat16:
        # As integers of 16 bits, which are sorted by radix: eight times as fast again.
        bits = numbers.view(torch.int16).numpy()
        ordered = np.argsort(bits ^ ((bits >> 15) & np.int16(0x7FFF)), axis=2, kind="stable")
    else:
        ordered = np.argsort(numbers.float().numpy(), axis=2)
    return torch.from_numpy(ordered).to(flat.device)


def _sorted(flat: Tensor) -> Tensor:
    """(B, C, n) sorted along n, without a gradient."""
    return torch.from_numpy(np.sort(flat.cpu().float().numpy(), axis=2)).to(flat)
