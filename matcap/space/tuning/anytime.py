"""Error of a capture over time, and a forecast of what more time would gain.

Errors of fine-tuning are distances between texture statistics, whose size says little. Beside the
photograph's *self-difference*, by how much neighbouring windows of one photograph differ, they do:
at 1 a rendering differs from the photograph as the photograph does from itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from matcap.flash.windows import Windows, side_by_side
from matcap.space.tuning.tuned import FORECAST
from matcap.statistics.compare import Weights, distance

History = Sequence[tuple[float, int, float]]  # seconds, step, running error


def self_difference(windows: Windows, weights: Weights) -> float:
    """Mean distance between windows of a photograph that lie side by side.

    Their mean colour, which follows the light, is left out. NaN where the photograph holds no two
    such windows.

    Args:
        windows: of one photograph.
        weights: of the statistics.
    """
    first, second = side_by_side(windows.points, windows.size)
    if not len(first):
        return math.nan
    target = windows.target
    difference = distance(
        target.select(first),
        target.select(second),
        replace(weights, mean=0.0),
    )
    return float(difference.mean())


def forecast(history: History, seconds: float) -> float | None:
    """The running error to be expected after so many more seconds, or None where too early to say.

    Errors of such searches fall about evenly with the logarithm of time; the slope is that of all
    but the beginning. Never higher than what there is: the best is kept.

    Args:
        history: of fine-tuning.
        seconds: from its end.
    """
    if not history:
        return None
    later = [point for point in history if point[0] >= FORECAST.since * history[-1][0]]
    if len(later) < FORECAST.least_steps:
        return None
    times = np.log([max(point[0], 1e-3) for point in later])
    errors = np.array([point[2] for point in later])
    spread = times - times.mean()
    slope = float((spread * errors).sum() / max(float((spread**2).sum()), 1e-12))
    now, error = history[-1][0], history[-1][2]
    return max(0.0, error + min(0.0, slope) * math.log((now + seconds) / now))


class Forecaster:
    """Progress of fine-tuning: errors in multiples of the photograph's self-difference."""

    def __init__(self, own: float) -> None:
        """Begin; `own` is the photograph's self-difference, NaN where it has none."""
        self._own = own
        self._history: list[tuple[float, int, float]] = []
        self._ahead: float | None = None

    def after(self, error: float, seconds: float) -> tuple[float | None, float | None]:
        """The error after one more step, and what another minute would bring it to."""
        self._history.append((seconds, len(self._history) + 1, error))
        if len(self._history) % FORECAST.every == 0:
            self._ahead = forecast(self._history, 60.0)
        return self._scaled(error), self._scaled(self._ahead)

    def _scaled(self, error: float | None) -> float | None:
        return error / self._own if error is not None and self._own > 0.0 else None
