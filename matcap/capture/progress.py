"""How far a capture is: its stages, and what fine-tuning may still bring."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from matcap.capture.anytime import forecast

_FORECAST_EVERY = 20  # steps
_MINUTE = 60.0  # seconds


@dataclass(frozen=True)
class CaptureProgress:
    """How far a capture is.

    Attributes:
        stage: its name.
        fraction: of the stage, in [0, 1].
        error: running error of fine-tuning in multiples of what the photograph's own windows
            differ by, or None.
        seconds: since the start.
        seconds_left: expected, or None.
        in_a_minute: error to be expected if it went on for another minute, or None.
    """

    stage: str
    fraction: float
    error: float | None
    seconds: float
    seconds_left: float | None
    in_a_minute: float | None = None


class CaptureClock:
    """Times the stages of a capture and tells the caller how far things are.

    Attributes:
        seconds: of each stage that is over.
        scale: what errors are told in: what the photograph's own windows differ by, once that is
            known.
    """

    def __init__(self, tell: Callable[[CaptureProgress], None] | None) -> None:
        self.seconds: dict[str, float] = {}
        self.scale = math.nan
        self._tell = tell or _nobody
        self._started = time.monotonic()
        self._history: list[tuple[float, int, float]] = []
        self._ahead: float | None = None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """A stage, while the block runs."""
        began = time.monotonic()
        self._tell(CaptureProgress(name, 0.0, None, began - self._started, None))
        yield
        self.seconds[name] = time.monotonic() - began
        self._tell(CaptureProgress(name, 1.0, None, time.monotonic() - self._started, None))

    def tuning(self, share: float, error: float, seconds: float) -> None:
        """A step of fine-tuning is done: share of all, running error, seconds of it so far."""
        left = seconds * (1.0 - share) / share if share > 0.01 else None
        elapsed = time.monotonic() - self._started
        self._history.append((seconds, len(self._history) + 1, error))
        if len(self._history) % _FORECAST_EVERY == 0:
            self._ahead = forecast(self._history, _MINUTE)
        told, ahead = self._scaled(error), self._scaled(self._ahead)
        self._tell(CaptureProgress("fine-tuning", share, told, elapsed, left, ahead))

    def finding(self, share: float) -> None:
        """A step of the exemplar is done: share of all."""
        elapsed = time.monotonic() - self._started
        self._tell(CaptureProgress("exemplar", share, None, elapsed, None))

    def _scaled(self, error: float | None) -> float | None:
        """An error that means something; None where there is nothing to compare it with."""
        return error / self.scale if error is not None and self.scale > 0.0 else None


def _nobody(progress: CaptureProgress) -> None:
    """Listens."""
