"""Regularisers of maps: penalties on structure that the photograph does not call for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet

_LOGIT_EPSILON = 1e-4  # of albedo, F0 and roughness: bounds the logit at 0 and 1


@dataclass(frozen=True)
class Penalties:
    """Weights of the penalties added to the texture distance; docs/notes/prior.md.

    Attributes: weights, and what they are of.
        slope: of the mean squared slope; relief must lower the loss by more.
        steep: of squared slopes beyond `steepest`.
        specular, roughness: of their logits' variance; what diffuse albedo explains as well is
            not to become blotches of gloss.
        departure: of mean maps that leave the coarse fit, in its squared deviations.
        outlier: of texels beyond `outlying` standard deviations of diffuse albedo, F0 or
            roughness, in their squared excess; few of them do not show in the statistics.
        outlying: standard deviations of a map.
        outliers_from: share of the work before outliers are penalised: what belongs there,
            as metal between rust, begins as specks too, and has spread by then.
        even: logits, added to the standard deviation: an even map has none.
        steepest: slopes beyond are not relief that a flash photograph shows: 45 degrees.
        belief: logits, prior deviations of the coarse fit's diffuse albedo (3), F0 and roughness:
            the texture's bumps widen the highlight, so its roughness is uncertain.
    """

    slope: float = 0.005
    specular: float = 0.02
    roughness: float = 0.01
    departure: float = 0.003
    outlier: float = 0.05
    steep: float = 0.3
    outlying: float = 4.0
    outliers_from: float = 0.5
    even: float = 0.05
    steepest: float = 1.0
    belief: tuple[float, float, float, float, float] = (0.4, 0.4, 0.4, 0.6, 2.0)


def price(maps: MapSet, expected: Tensor | None, weights: Penalties, share: float) -> Tensor:
    """Penalty of maps (B, ., H, W); a number, differentiable.

    Args:
        maps: of one step.
        expected: (5,) logits of the coarse fit's diffuse albedo, F0 and roughness, or None.
        weights: of the terms.
        share: of the work that is done.
    """
    normal = maps.normal
    squared = (normal[:, :2] / normal[:, 2:]).square().sum(dim=1)
    steep = torch.relu((squared + 1e-6).sqrt() - weights.steepest).square().mean()
    penalty = weights.slope * squared.mean() + weights.steep * steep
    # Of a coloured F0 the mean is compared, as the fit's is grey.
    maps = replace(maps, specular=maps.specular.mean(dim=1, keepdim=True))
    specular = torch.logit(maps.specular, eps=_LOGIT_EPSILON)
    roughness = torch.logit(maps.roughness, eps=_LOGIT_EPSILON)
    penalty = penalty + weights.specular * specular.var()
    penalty = penalty + weights.roughness * roughness.var()
    if share > weights.outliers_from:
        diffuse = torch.logit(maps.diffuse, eps=_LOGIT_EPSILON)
        penalty = penalty + weights.outlier * _outlying([diffuse, specular, roughness], weights)
    if expected is not None:
        penalty = penalty + weights.departure * _departure(maps, expected, weights)
    return penalty


def _outlying(logits: list[Tensor], weights: Penalties) -> Tensor:
    reflectance = torch.cat(logits, dim=1)
    deviation = reflectance - reflectance.mean(dim=(0, 2, 3), keepdim=True)
    variance = deviation.square().mean(dim=(0, 2, 3), keepdim=True)
    outlying = torch.relu(deviation.abs() / (variance + weights.even**2).sqrt() - weights.outlying)
    return outlying.square().mean((0, 2, 3)).sum()


def _departure(maps: MapSet, expected: Tensor, weights: Penalties) -> Tensor:
    # The fit saw a blurred photograph: what it says is the mean, not the mean of logits.
    linear = torch.cat([maps.diffuse, maps.specular, maps.roughness], dim=1)
    means = torch.logit(linear.mean(dim=(0, 2, 3)), eps=_LOGIT_EPSILON)
    return ((means - expected) / expected.new_tensor(weights.belief)).square().sum()
