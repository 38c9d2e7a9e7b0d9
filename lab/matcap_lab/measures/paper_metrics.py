"""The paper's metrics of diversity and of likeness of colour (section 5.2).

Diversity of several realisations of one material: the paper's is the mean pairwise L1 distance of
VGG features over all of them, after [henzler2020]; here of RandomFilters' (style.py). They are
compared pixel by pixel: the same texture with its features displaced is another picture. Features
of several scales, not pixels, make the measure robust to noise.

Likeness ("XYZ histogram L1 difference"): the paper does not say how many bins its histograms have;
here it is 64 a channel, from black to the white of sRGB.
"""

from __future__ import annotations

import itertools

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.files.srgb import srgb_decode
from matcap_lab.measures.style import RandomFilters
from matcap_lab.simulate.write_dng import REC709_TO_XYZ


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


BINS = 64


def xyz_histograms(picture: Tensor) -> NDArray[np.float64]:
    """(3, BINS) normalised histograms of X, Y and Z of an sRGB picture (3, H, W) in [0, 1]."""
    light = srgb_decode(picture.double().flatten(1).numpy())
    white = REC709_TO_XYZ.sum(axis=1, keepdims=True)
    shares = (REC709_TO_XYZ @ light / white).clip(0.0, 1.0)
    counts = [np.histogram(channel, BINS, (0.0, 1.0))[0] for channel in shares]
    return np.stack(counts) / light.shape[1]


def xyz_difference(first: Tensor, second: Tensor) -> float:
    """Half the L1 difference of histograms of sRGB pictures (3, H, W), the mean of X, Y and Z.

    0 for equal histograms, 1 for disjoint ones. The pictures may differ in size.
    """
    difference = np.abs(xyz_histograms(first) - xyz_histograms(second)).sum(axis=1)
    return float(difference.mean() / 2.0)
