"""Diversity of several realisations of one material (paper, section 5.2, "diversity").

The paper's is the mean pairwise L1 distance of VGG features over all realisations, after
[henzler2020]; here the features are RandomFilters' (style.py). They are compared pixel by pixel:
the same texture with its features displaced is another picture. Features of several scales, not
pixels, make the measure robust to noise.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor

from matcap.lab.measures.style import RandomFilters


def diversity(pictures: Tensor) -> float:
    """Mean pairwise distance between sRGB pictures (N, 3, H, W) of the same size and light.

    The distance of two is the mean over levels of |a - b|_1 / ((|a|_1 + |b|_1) / 2), a and b the
    features of all pixels: 0 for equal pictures, at most 2. A single picture has 0.
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
