"""Schedule of fine-tuning: end, freezing and learning rate."""

from __future__ import annotations

import math
import time

# Settings of every optimisation run; docs/notes/prior.md.
_WARM_UP = 10  # steps of linear warm-up of the learning rate
_FLOOR = 0.05  # final share of the learning rate
_FROZEN_SHARE = 0.15  # last share of the run, with frozen statistics


class Schedule:
    """Progress of a run, which ends by steps or by time, whichever is first.

    Attributes:
        step: number of completed steps.
        share: completed share of the run, in [0, 1], updated by `over`.
    """

    def __init__(self, steps: int, seconds: float | None) -> None:
        """Start the clock.

        Args:
            steps: largest number of steps.
            seconds: time limit, or None.
        """
        self.step, self.share = 0, 0.0
        self._steps, self._limit = steps, seconds
        self._started = time.monotonic()

    def over(self) -> bool:
        """Update `share` from steps and clock; whether the run is done."""
        self.share = self.step / self._steps
        if self._limit is not None:
            self.share = max(self.share, self.seconds / self._limit if self._limit > 0.0 else 1.0)
        return self.share >= 1.0

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._started

    @property
    def freezes(self) -> bool:
        """Whether the remaining steps use frozen statistics."""
        return self.share >= 1.0 - _FROZEN_SHARE

    @property
    def pace(self) -> float:
        """Share of the learning rate: a warm-up, then a cosine down to _FLOOR."""
        warm = min(1.0, (self.step + 1) / _WARM_UP)
        return warm * (_FLOOR + (1.0 - _FLOOR) * (0.5 + 0.5 * math.cos(math.pi * self.share)))
