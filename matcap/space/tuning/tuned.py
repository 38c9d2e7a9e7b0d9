"""What is tuned of fine-tuning a decoder: one frozen dataclass a stage; docs/notes/capture.md."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HeadSettings:
    """Where a decoder begins that knows nothing.

    Attributes:
        contrast_gain: of diffuse albedo's contrast: a sigmoid's slope below 1/2 is under 1, so that
            logits must swing a little further.
        specular_contrast: logits.
        roughness_contrast: logits.
        relief: texels: hardly any, so that colour explains first.
    """

    contrast_gain: float = 1.2
    specular_contrast: float = 0.1
    roughness_contrast: float = 0.1
    relief: float = 0.15


HEAD = HeadSettings()


@dataclass(frozen=True)
class GuardSettings:
    """When a step has gone wrong.

    Attributes:
        smoothing: of the running error.
        exploded: times the running error.
        least_error: that the running error counts as at least, when it is asked what explodes.
        snapshot_every: steps.
        longest_gradient: norm over all weights, beyond which it is shortened.
    """

    smoothing: float = 0.05
    exploded: float = 4.0
    least_error: float = 0.1
    snapshot_every: int = 20
    longest_gradient: float = 1.0


GUARD = GuardSettings()


@dataclass(frozen=True)
class ForecastSettings:
    """When an error is forecast.

    Attributes:
        every: steps.
        least_steps: fewer do not show where the error is going.
        since: share of the time from which errors count. Of the later half alone, a few low windows
            were taken for a fall: off by up to a third.
    """

    every: int = 20
    least_steps: int = 20
    since: float = 0.1


FORECAST = ForecastSettings()


@dataclass(frozen=True)
class MatchSettings:
    """How a tuned decoder's mean and contrast are moved to the photograph's.

    Attributes:
        rounds: of comparing and moving.
        block: texels a side over which light is averaged before means are compared.
        clipped: of the clip level: brighter than this may be cut off.
        least_seen: share of the texels; of fewer nothing is concluded.
        damping: of a shift, beside a squared share of diffuse light: where most light is mirrored,
            what is missing of it says little about the diffuse albedo.
        gain_step: bounds of one round, and ...
        gain: ... of all together: more is another material's doing.
        shift: logits of diffuse albedo, likewise.
    """

    rounds: int = 3
    block: int = 32
    clipped: float = 0.97
    least_seen: float = 0.05
    damping: float = 0.1
    gain_step: tuple[float, float] = (0.7, 1.4)
    gain: tuple[float, float] = (0.6, 1.7)
    shift: float = 1.0


MATCH = MatchSettings()
