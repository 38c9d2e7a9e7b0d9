"""Tuned constants of fine-tuning, one frozen dataclass a stage; docs/notes/prior.md."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HeadSettings:
    """Initial deviations of a random decoder's outputs."""

    contrast_gain: float = 1.2
    """Logits of diffuse albedo per log radiance: d log sigmoid(x) / dx is below 1."""
    specular_contrast: float = 0.1
    """Initial standard deviation of the logit of F0."""
    roughness_contrast: float = 0.1
    """Initial standard deviation of the logit of roughness."""
    relief: float = 0.15
    """Initial standard deviation of height, texels."""


HEAD = HeadSettings()


@dataclass(frozen=True)
class RollbackSettings:
    """When a step counts as diverged."""

    smoothing: float = 0.05
    """Weight of the newest step in the running error."""
    exploded: float = 4.0
    """Loss over running error beyond which a step diverges."""
    least_error: float = 0.1
    """Lower limit of the running error in that ratio."""
    snapshot_every: int = 20
    """Steps between comparisons with the best decoder."""
    longest_gradient: float = 1.0
    """Norm over all weights to which gradients are clipped."""


ROLLBACK = RollbackSettings()


@dataclass(frozen=True)
class ForecastSettings:
    """Forecast of the error."""

    every: int = 20
    """Steps between forecasts."""
    least_steps: int = 20
    """Steps that a forecast needs."""
    since: float = 0.1
    """Share of the time from which on steps are fitted. With 0.5, random low errors made forecasts
    wrong by up to a third."""


FORECAST = ForecastSettings()


@dataclass(frozen=True)
class MatchSettings:
    """Correction of a decoder's mean and contrast."""

    rounds: int = 3
    """Iterations."""
    block: int = 32
    """Texels: side of the blocks over which radiance is averaged."""
    clipped: float = 0.97
    """Share of the clip level above which texels are not compared."""
    least_seen: float = 0.05
    """Least share of texels to compare."""
    damping: float = 0.1
    """Added to the squared diffuse share; it limits shifts where most light is specular."""
    gain_step: tuple[float, float] = (0.7, 1.4)
    """Limits of the gain in one iteration."""
    gain: tuple[float, float] = (0.6, 1.7)
    """Limits of the whole gain."""
    shift: float = 1.0
    """Limit of the whole shift, logits of diffuse albedo."""


MATCH = MatchSettings()
