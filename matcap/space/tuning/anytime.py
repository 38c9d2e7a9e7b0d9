"""Error of fine-tuning in multiples of the photograph's self-difference, and its forecast.

Errors are distances between texture statistics. The *self-difference* is the mean distance between
adjacent windows of the photograph: at an error of 1 self-difference the rendering differs from the
photograph as much as the photograph's parts do from each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from matcap.space.tuning.windows import Windows, side_by_side
from matcap.statistics.compare import Weights, distance

# The forecast of the error; docs/notes/prior.md.
_EVERY = 20  # steps between forecasts
_LEAST_STEPS = 20  # steps that a forecast needs
# Share of the time from which on steps are fitted. With 0.5, random low errors made forecasts
# wrong by up to a third.
_SINCE = 0.1

History = Sequence[tuple[float, int, float]]  # seconds, step, running error


def self_difference(windows: Windows, weights: Weights) -> float:
    """Mean distance between adjacent windows of a photograph, without their mean colour.

    The mean colour depends on the light. NaN if no two windows are adjacent.

    Args:
        windows: of one photograph.
    """
    first, second = side_by_side(windows.points, windows.size)
    if not len(first):
        return math.nan
    target = windows.target
    pairs = target.select(first), target.select(second)
    return float(distance(*pairs, replace(weights, mean=0.0)).mean())


def forecast(history: History, seconds: float) -> float | None:
    """Extrapolate the running error by a line in log time, fitted to all but the first steps.

    Never more than the present error, as the best decoder is kept; None with too few steps.

    Args:
        seconds: after the history's end.
    """
    if not history:
        return None
    later = [point for point in history if point[0] >= _SINCE * history[-1][0]]
    if len(later) < _LEAST_STEPS:
        return None
    times = np.log([max(point[0], 1e-3) for point in later])
    errors = np.array([point[2] for point in later])
    spread = times - times.mean()
    slope = float((spread * errors).sum() / max(float((spread**2).sum()), 1e-12))
    now, error = history[-1][0], history[-1][2]
    return max(0.0, error + min(0.0, slope) * math.log((now + seconds) / now))


class Forecaster:
    """Error and forecast of fine-tuning, in multiples of the photograph's self-difference.

    Args:
        self_difference: of the photograph; NaN makes errors None.
    """

    def __init__(self, self_difference: float) -> None:
        self._self_difference = self_difference
        self._history: list[tuple[float, int, float]] = []
        self._ahead: float | None = None

    def after(self, error: float, seconds: float) -> tuple[float | None, float | None]:
        """Add a step; return the error and its forecast for another minute."""
        self._history.append((seconds, len(self._history) + 1, error))
        if len(self._history) % _EVERY == 0:
            self._ahead = forecast(self._history, 60.0)
        return self._scaled(error), self._scaled(self._ahead)

    def _scaled(self, error: float | None) -> float | None:
        if error is None or not self._self_difference > 0.0:
            return None
        return error / self._self_difference
