"""Regularisers of maps: penalties on structure that the photograph does not need."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet

_LOGIT_EPSILON = 1e-4  # of albedo, F0 and roughness: bounds the logit at 0 and 1


@dataclass(frozen=True)
class Penalties:
    """Weights of the penalties added to the texture distance; docs/notes/prior.md."""

    slope: float = 0.005
    """Weight of the mean squared slope."""
    specular: float = 0.02
    roughness: float = 0.01
    """Weights of the variances of their logits, so that diffuse albedo is preferred where it
    explains the photograph as well."""
    departure: float = 0.003
    """Weight of the squared difference of mean maps from the coarse fit, over `fit_deviation`."""
    outlier: float = 0.05
    """Weight of the squared excess of texels over `outlying` standard deviations, in logits of
    diffuse albedo, F0 and roughness; the statistics do not see few of them."""
    steep: float = 0.3
    """Weight of the squared excess of slopes over `steepest`."""
    outlying: float = 4.0
    """Standard deviations of a map beyond which a texel is an outlier."""
    outliers_from: float = 0.5
    """Share of the steps before outliers are penalised, as real features (metal between rust) also
    begin as specks."""
    even: float = 0.05
    """Logits, added in quadrature to the standard deviation of a map."""
    steepest: float = 1.0
    """Slope; 1 is 45 degrees, the steepest that a flash photograph shows."""
    fit_deviation: tuple[float, float, float, float, float] = (0.4, 0.4, 0.4, 0.6, 2.0)
    """Standard deviations of the coarse fit's logits of diffuse albedo (3), F0 and roughness; the
    last is large because relief widens the highlight, which biases roughness."""


def map_penalty(maps: MapSet, expected: Tensor | None, weights: Penalties, share: float) -> Tensor:
    """Penalty of maps (B, ., H, W), a differentiable scalar.

    Args:
        expected: (5,) logits of the coarse fit's diffuse albedo, F0 and roughness, or None.
        share: completed share of the steps, in [0, 1].
    """
    normal = maps.normal
    squared = (normal[:, :2] / normal[:, 2:]).square().sum(dim=1)
    steep = torch.relu((squared + 1e-6).sqrt() - weights.steepest).square().mean()
    penalty = weights.slope * squared.mean() + weights.steep * steep
    # A coloured F0 is averaged over channels, as the coarse fit's is achromatic.
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
    """Mean squared excess of outliers, summed over channels, in standard deviations."""
    reflectance = torch.cat(logits, dim=1)
    deviation = reflectance - reflectance.mean(dim=(0, 2, 3), keepdim=True)
    variance = deviation.square().mean(dim=(0, 2, 3), keepdim=True)
    outlying = torch.relu(deviation.abs() / (variance + weights.even**2).sqrt() - weights.outlying)
    return outlying.square().mean((0, 2, 3)).sum()


def _departure(maps: MapSet, expected: Tensor, weights: Penalties) -> Tensor:
    """Squared standardised difference of mean maps from the coarse fit."""
    # The fit is to a blurred photograph, so it estimates means of maps, not of logits.
    linear = torch.cat([maps.diffuse, maps.specular, maps.roughness], dim=1)
    means = torch.logit(linear.mean(dim=(0, 2, 3)), eps=_LOGIT_EPSILON)
    return ((means - expected) / expected.new_tensor(weights.fit_deviation)).square().sum()
