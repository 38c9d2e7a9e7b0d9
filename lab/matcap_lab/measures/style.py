"""Style distances of textures, by statistics that no capture optimises.

The distance is the mean over groups g of statistics of the relative difference

    |a_g - b_g|_1 / ((|a_g|_1 + |b_g|_1) / 2),

at most 2, so that no group dominates.

1. *Random filters* of other sizes (7, 11, 13) and another seed than capture's, on a pyramid of four
   levels, rectified: groups are Gram matrices and means by level. The raw colours are among the
   means.
2. *Patches*: sliced Wasserstein distance [rabin2011] of patches [elnekave2022] of 3, 7 and 15
   texels a side at three scales, projected on random directions and sorted. Sensitive to colours,
   edges and grain, hardly to structures longer than a patch.

All are 0 for equal pictures, and symmetric.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.files.color import srgb_decode
from matcap.statistics.compare import FilterBank, FilterBankConfig, gram, pyramid
from matcap_lab.simulate.files import REC709_TO_XYZ


@dataclass(frozen=True)
class Group:
    """Statistics (B, N) that enter the distance as one term; their threshold of visibility t_g."""

    values: Tensor
    unseen: float


StyleStatistics = dict[str, Group]


def srgb_encode_tensor(light: Tensor) -> Tensor:
    """files.color.srgb_encode for PyTorch; its gradient is finite everywhere."""
    power = 1.055 * light.clamp_min(0.0031308).pow(1.0 / 2.4) - 0.055
    return (12.92 * light).where(light <= 0.0031308, power)


class Style(Protocol):
    """Texture statistics: sRGB pictures (B, 3, H, W) in [0, 1] to groups."""

    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Style statistics of pictures."""
        ...


def difference(first: StyleStatistics, second: StyleStatistics) -> Tensor:
    """(B,) distance between pictures of the same lights, the mean over groups."""
    return torch.stack([_relative(first[name], second[name]) for name in first]).mean(0)


class RandomFilters:
    """Gram matrices and means of random filters other than capture's."""

    def __init__(self) -> None:
        self._bank = FilterBank(FilterBankConfig(sizes=(7, 11, 13), filters=20, levels=4, seed=777))

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe (B, 3, H, W)."""
        groups = {}
        for level, image in enumerate(pyramid(pictures, self._bank.config.levels)):
            features = self._bank.features(image.contiguous(memory_format=torch.channels_last))
            means = torch.cat([features.mean((2, 3)), image.mean((2, 3))], dim=1)
            groups[f"gram {level}"] = Group(gram(features)[:, :-1, :-1].flatten(1), 0.0)
            groups[f"means {level}"] = Group(means, 0.0)
        return groups

    @torch.no_grad()
    def features(self, pictures: Tensor) -> list[Tensor]:
        """Rectified responses (B, filters, h, w) at every pyramid level of (B, 3, H, W)."""
        return self._bank.maps(pictures, pyramid(pictures, self._bank.config.levels))


def _relative(first: Group, second: Group) -> Tensor:
    """(B,) relative L1 difference of a group."""
    difference = (first.values - second.values).abs().mean(1)
    size = (first.values.abs().mean(1) + second.values.abs().mean(1)) / 2.0
    return difference / (size + first.unseen).clamp_min(1e-12)


SIDES = (3, 7, 15)  # texels of a patch
SCALES = 3  # each of half the size of the one before
_DIRECTIONS = 64  # a side and scale
_QUANTILES = 128  # along each
_SEED = 4242
_UNSEEN = 0.005  # about one 8-bit code value


class Patches:
    """Sorted projections of patches."""

    def __init__(self) -> None:
        """Draw directions, all of unit length."""
        generator = torch.Generator().manual_seed(_SEED)
        self._directions = []
        for side in SIDES:
            drawn = torch.randn(_DIRECTIONS, 3, side, side, generator=generator)
            self._directions.append(drawn / drawn.flatten(1).norm(dim=1)[:, None, None, None])

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe sRGB-encoded pictures (B, 3, H, W) in [0, 1].

        Raises:
            ValueError: pictures whose coarsest scale holds no patch.
        """
        if min(pictures.shape[-2:]) < max(SIDES) * 2 ** (SCALES - 1):
            raise ValueError(f"pictures of {tuple(pictures.shape)} are too small to be compared")
        shares = (torch.arange(_QUANTILES) + 0.5) / _QUANTILES
        groups = {}
        for scale in range(SCALES):
            picture = F.avg_pool2d(pictures, 2**scale)
            for side, directions in zip(SIDES, self._directions, strict=True):
                along = F.conv2d(picture, directions).flatten(2).sort(dim=2).values
                places = (shares * along.shape[2]).long()
                groups[f"scale {scale}, side {side}"] = Group(
                    along[..., places].flatten(1), _UNSEEN
                )
        return groups


# The paper's metrics of diversity and of likeness of colour (section 5.2).
#
# Diversity of several realisations of one material: the paper's is the mean pairwise L1 distance of
# VGG features over all of them, after [henzler2020]; here of RandomFilters' (style.py). They are
# compared pixel by pixel: the same texture with its features displaced is another picture. Features
# of several scales, not pixels, make the measure robust to noise.
#
# Likeness ("XYZ histogram L1 difference"): the paper does not say how many bins its histograms
# have; here it is 64 a channel, from black to the white of sRGB.


def diversity(pictures: Tensor) -> float:
    """Mean pairwise distance between sRGB pictures (N, 3, H, W) of the same size and light.

    The distance of two is the mean over levels of |a - b|_1 / ((|a|_1 + |b|_1) / 2), a and b the
    features of all pixels: 0 for equal pictures, at most 2. A single picture has 0.
    """
    levels = RandomFilters().features(pictures)
    distances = [
        torch.stack([_relative_l1(level[i], level[j]) for level in levels]).mean()
        for i, j in itertools.combinations(range(len(pictures)), 2)
    ]
    return float(torch.stack(distances).mean()) if distances else 0.0


def _relative_l1(first: Tensor, second: Tensor) -> Tensor:
    size = (first.abs().mean() + second.abs().mean()) / 2.0
    return (first - second).abs().mean() / size.clamp_min(1e-12)


BINS = 64


def xyz_histograms(picture: Tensor) -> NDArray[np.float64]:
    """(3, BINS) normalised histograms of X, Y and Z of an sRGB picture (3, H, W) in [0, 1]."""
    light = srgb_decode(picture.double().flatten(1).numpy())
    shares = (REC709_TO_XYZ @ light / REC709_TO_XYZ.sum(axis=1, keepdims=True)).clip(0.0, 1.0)
    counts = [np.histogram(channel, BINS, (0.0, 1.0))[0] for channel in shares]
    return np.stack(counts) / light.shape[1]


def xyz_difference(first: Tensor, second: Tensor) -> float:
    """Half the L1 difference of histograms of sRGB pictures (3, H, W), the mean of X, Y and Z.

    0 for equal histograms, 1 for disjoint ones. The pictures may differ in size.
    """
    difference = np.abs(xyz_histograms(first) - xyz_histograms(second)).sum(axis=1)
    return float(difference.mean() / 2.0)


# Precision, recall and diversity of generated pictures.
#
# Improved precision and recall [kynkaanniemi2019]. Each picture of a set has a ball whose radius is
# the distance to its k-th nearest neighbour in the set. Precision is the share of generated
# pictures within the balls of the true ones, recall the share of true pictures within the balls of
# the generated ones. Distances are those of RandomFilters (style.py), used by no training.

NEIGHBOUR = 3  # the k of the paper


@dataclass(frozen=True)
class Variety:
    """Precision, recall and diversity of generated pictures against a set of true ones."""

    precision: float
    """Share of generated pictures within the balls of true ones, 0 to 1."""
    recall: float
    """Share of true pictures within the balls of generated ones, 0 to 1."""
    mean_distance: float
    """Mean style distance of two generated pictures, 0 to 2."""
    spread: float
    """`mean_distance` over the mean style distance of two true pictures."""
    nearest: Tensor
    """(generated,) index of the true picture nearest to each generated one."""


def variety(made: StyleStatistics, true: StyleStatistics) -> Variety:
    """Compare generated pictures with true ones, more than NEIGHBOUR (k) each."""
    across = style_distances(made, true)
    within, within_true = style_distances(made, made), style_distances(true, true)
    return Variety(
        precision=_covered(across, reaches(within_true)),
        recall=_covered(across.T, reaches(within)),
        mean_distance=mean_pairwise(within),
        spread=mean_pairwise(within) / mean_pairwise(within_true),
        nearest=across.argmin(dim=1),
    )


def describe_pictures(pictures: Sequence[Tensor]) -> StyleStatistics:
    """Statistics of sRGB pictures (3, H, W), computed one by one to save memory."""
    style = RandomFilters()
    return joined([style(picture[None]) for picture in pictures])


def joined(parts: Sequence[StyleStatistics]) -> StyleStatistics:
    """Statistics of several batches, concatenated along the pictures."""
    return {
        name: Group(torch.cat([part[name].values for part in parts]), group.unseen)
        for name, group in parts[0].items()
    }


def style_distances(first: StyleStatistics, second: StyleStatistics) -> Tensor:
    """(N, M) distances between N and M pictures: style.difference of every pair."""
    distances = []
    for name, group in first.items():
        one, other = group.values, second[name].values
        count = one.shape[1]
        sizes = one.abs().mean(1)[:, None] + other.abs().mean(1)[None, :]
        difference = torch.cdist(one, other, p=1.0) / count
        distances.append(difference / (sizes / 2.0 + group.unseen).clamp_min(1e-12))
    return torch.stack(distances).mean(0)


def reaches(within: Tensor) -> Tensor:
    """(N,) distance to the NEIGHBOUR-th nearest member, from distances (N, N)."""
    return within.sort(dim=1).values[:, NEIGHBOUR]  # the first is the member itself


def mean_pairwise(within: Tensor) -> float:
    """Mean distance of two different members, from (N, N)."""
    count = len(within)
    return float(within.sum() - within.diagonal().sum()) / (count * (count - 1))


def _covered(across: Tensor, reach: Tensor) -> float:
    """Share of N pictures in the ball of any of M, from distances (N, M) and radii (M,)."""
    return float((across <= reach).any(dim=1).float().mean())
