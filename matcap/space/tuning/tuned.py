"""What is tuned of fine-tuning a decoder: one frozen dataclass a stage; docs/notes/prior.md."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HeadSettings:
    """Where a decoder begins that knows nothing."""

    contrast_gain: float = 1.2
    """Of diffuse albedo's contrast: a sigmoid's slope below 1/2 is under 1, so that logits must
    swing a little further."""
    specular_contrast: float = 0.1
    """Logits."""
    roughness_contrast: float = 0.1
    """Logits."""
    relief: float = 0.15
    """Texels: hardly any, so that colour explains first."""


HEAD = HeadSettings()


@dataclass(frozen=True)
class GuardSettings:
    """When a step has gone wrong."""

    smoothing: float = 0.05
    """Of the running error."""
    exploded: float = 4.0
    """Times the running error."""
    least_error: float = 0.1
    """That the running error counts as at least, when it is asked what explodes."""
    snapshot_every: int = 20
    """Steps."""
    longest_gradient: float = 1.0
    """Norm over all weights, beyond which it is shortened."""


GUARD = GuardSettings()


@dataclass(frozen=True)
class ForecastSettings:
    """When an error is forecast."""

    every: int = 20
    """Steps."""
    least_steps: int = 20
    """Fewer do not show where the error is going."""
    since: float = 0.1
    """Share of the time from which errors count. Of the later half alone, a few low windows were
    taken for a fall: off by up to a third."""


FORECAST = ForecastSettings()


@dataclass(frozen=True)
class MatchSettings:
    """How a tuned decoder's mean and contrast are moved to the photograph's."""

    rounds: int = 3
    """Of comparing and moving."""
    block: int = 32
    """Texels a side over which light is averaged before means are compared."""
    clipped: float = 0.97
    """Of the clip level: brighter than this may be cut off."""
    least_seen: float = 0.05
    """Share of the texels; of fewer nothing is concluded."""
    damping: float = 0.1
    """Of a shift, added to the squared diffuse share: where most light is mirrored, what is
    missing of it says little about the diffuse albedo."""
    gain_step: tuple[float, float] = (0.7, 1.4)
    """Bounds of one round, and ..."""
    gain: tuple[float, float] = (0.6, 1.7)
    """... of all together: more is another material's doing."""
    shift: float = 1.0
    """Logits of diffuse albedo, likewise."""


MATCH = MatchSettings()
