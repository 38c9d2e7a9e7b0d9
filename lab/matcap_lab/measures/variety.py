"""Precision, recall and diversity of generated pictures.

Improved precision and recall [kynkaanniemi2019]. Each picture of a set has a ball whose radius is
the distance to its k-th nearest neighbour in the set. Precision is the share of generated pictures
within the balls of the true ones, recall the share of true pictures within the balls of the
generated ones. Distances are those of RandomFilters (style.py), used by no training.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap_lab.measures.style import Group, RandomFilters, StyleStatistics

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
