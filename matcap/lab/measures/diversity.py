"""Diversity of several realisations of one material (paper, section 5.2, "diversity").

The paper's is the mean pairwise L1 of VGG features over all realisations, after
[henzler2020]; here the features are those
of RandomFilters (style.py). They are compared place by place, so that the same texture with its
grains elsewhere counts as another picture; and as features of several scales, not as pixels, so
that faint noise does not count.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor

from matcap.lab.measures.style import RandomFilters


def diversity(pictures: Tensor) -> float:
    """Mean pairwise distance between sRGB pictures (N, 3, H, W) of the same size and light.

    The distance of two is the mean over levels of |a - b|_1 / ((|a|_1 + |b|_1) / 2), a and b the
    features of all places: 0 for the same picture, at most 2. One picture alone has 0.
    """
    levels = RandomFilters().features(pictures)
    distances = [
        torch.stack([_relative(level[i], level[j]) for level in levels]).mean()
        for i, j in itertools.combinations(range(len(pictures)), 2)
    ]
    return float(torch.stack(distances).mean()) if distances else 0.0


def _relative(first: Tensor, second: Tensor) -> Tensor:
    size = (first.abs().mean() + second.abs().mean()) / 2.0
    return (first - second).abs().mean() / size.clamp_min(1e-12)
