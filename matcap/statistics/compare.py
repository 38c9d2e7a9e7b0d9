"""Descriptors of texture windows and the distance between them (paper, section 4.3).

A descriptor holds, per pyramid level, the Gram matrix of the features, their covariance with those
of the next coarser level, the autocorrelation of the colours (the power spectrum's transform) and
the colours' distribution; and the window's mean colour. The distance is a sum of L1 differences,
each relative to the target's own size, so that no level and no kind of statistic drowns the others.

Gram matrices of single levels do not capture where fine structure sits in coarse structure, as in
an edge: its levels rise at the same places. Covariances between levels do (Portilla and Simoncelli
2000 hold parent and child bands together for the same reason).
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


@dataclass(frozen=True)
class CompareSettings:
    """What is tuned of descriptors; docs/notes/prior.md."""

    reach: int = 12
    """Lags of the autocorrelation at every level, in that level's texels."""
    quantiles: int = 64
    """Of each channel's values."""
    largest: int = 144
    """Texels a side of what is looked at on one level."""


COMPARE = CompareSettings()

# Mean size below which a target's statistic cannot be seen, and is not what others are measured
# by: a tenth of the faintest found in photographs of textures. Without it a plain photograph's
# error is a division by nothing.
UNSEEN = 1e-3


class Features(Protocol):
    """What textures are compared by: a FilterBank, or a trained network (vgg.py)."""

    @property
    def levels(self) -> int:
        """Of the pyramid of colours."""
        ...

    @property
    def crossed(self) -> bool:
        """Whether maps, each half the size of the one before, are compared across levels, too."""
        ...

    def maps(self, linear: Tensor, colours: Sequence[Tensor]) -> list[Tensor]:
        """Responses (B, C, h, w), several, to radiance (B, 3, H, W) and its pyramid of colours."""
        ...


@dataclass(frozen=True)
class Weights:
    """How much each kind of statistic counts."""

    gram: float = 1.0
    cross: float = 1.0
    spectrum: float = 1.0
    histogram: float = 0.5
    mean: float = 1.0


@dataclass(frozen=True)
class Descriptor:
    """Statistics of B windows."""

    mean: Tensor
    """(B, 6) mean log colour, and log of the mean colour: where contrast is strong, dark parts
    outweigh the bright ones in the one, and bright ones in the other."""
    grams: tuple[Tensor, ...]
    """Per map of the features (B, F + 1, F + 1); the last feature is the constant 1, so the last
    column holds the features' means."""
    crosses: tuple[Tensor, ...]
    """Per pair of neighbouring maps (B, F, F) covariances of their features."""
    spectra: tuple[Tensor, ...]
    """Per level (B, 3, lags, lags)."""
    quantiles: tuple[Tensor, ...]
    """Per level (B, 3, Q) of the colours about their mean."""

    def select(self, index: Tensor | Sequence[int]) -> Descriptor:
        """The descriptors of some windows."""
        return Descriptor(
            self.mean[index],
            tuple(g[index] for g in self.grams),
            tuple(c[index] for c in self.crosses),
            tuple(s[index] for s in self.spectra),
            tuple(q[index] for q in self.quantiles),
        )

    @staticmethod
    def joined(parts: Sequence[Descriptor]) -> Descriptor:
        """Descriptors of all windows of several."""
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
    average = encoding.log(linear.clamp(0.0, 1.0).mean(dim=(2, 3), keepdim=True))
    return Descriptor(
        mean=torch.cat([log.mean(dim=(2, 3)), average[..., 0, 0]], dim=1),
        grams=grams,
        crosses=crosses,
        spectra=tuple(
            autocorrelation(level, min(COMPARE.reach, min(level.shape[-2:]) // 2 - 1))
            for level in levels
        ),
        quantiles=tuple(_quantiles(level) for level in levels),
    )


def distance(sample: Descriptor, target: Descriptor, weights: Weights) -> Tensor:
    """(B,) how far apart windows look; 0 for the same statistics, about 1 for unlike textures."""
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
    """The middle of a pyramid level: fine levels hold more texels than their statistics need."""
    height, width = level.shape[-2:]
    y, x = max(0, height - COMPARE.largest) // 2, max(0, width - COMPARE.largest) // 2
    return level[..., y : y + min(height, COMPARE.largest), x : x + min(width, COMPARE.largest)]


def _relative(sample: Tensor, target: Tensor) -> Tensor:
    """(B,) L1 difference as a share of the target's L1 size."""
    size = target.abs().flatten(1).mean(dim=1)
    return (sample - target).abs().flatten(1).mean(dim=1) / size.clamp_min(UNSEEN)


def _quantiles(level: Tensor) -> Tensor:
    """(B, 3, Q) evenly spaced quantiles of the colours about their mean."""
    flat = level.flatten(2)
    count = min(COMPARE.quantiles, flat.shape[2])
    chunk = flat.shape[2] // count
    ordered = (flat - flat.mean(dim=2, keepdim=True)).gather(2, _order(flat))
    return ordered[..., : chunk * count].unflatten(2, (count, chunk)).mean(dim=3)


def _order(flat: Tensor) -> Tensor:
    """(B, C, n) places of values (B, C, n), the least one's first: NumPy's, five times as fast."""
    return torch.from_numpy(np.argsort(flat.detach().cpu().float().numpy(), axis=2)).to(flat.device)
