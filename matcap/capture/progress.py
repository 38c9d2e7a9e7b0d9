"""Progress of a capture: its stages, each with its share of the time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from types import MappingProxyType

from matcap.files.progress import Progress, ignore_progress

# Stages of a capture in order, each with its share of the time, by report.json's stage_seconds of
# one photograph of 12 megapixels with the preset `standard`.
EXEMPLAR_STAGES: Mapping[str, float] = MappingProxyType(
    {
        "read": 0.02,
        "coarse fit": 0.18,
        "network": 0.06,
        "relief spectrum": 0.03,
        "refine": 0.07,
        "inpaint": 0.10,
        "index": 0.13,
        "verdict": 0.24,
        "write": 0.17,
    }
)
# The same of five photographs of one sample.
MULTIVIEW_STAGES: Mapping[str, float] = MappingProxyType(
    {
        "read": 0.04,
        "register": 0.12,
        "coarse fit": 0.02,
        "network": 0.11,
        "relief spectrum": 0.04,
        "refine": 0.05,
        "align": 0.10,
        "solve": 0.30,
        "predict": 0.08,
        "inpaint": 0.01,
        "index": 0.05,
        "verdict": 0.04,
        "write": 0.04,
    }
)
# The same of a decoder that reads a drawing, and of one that does not.
DRAWING_STAGES: Mapping[str, float] = MappingProxyType(
    {
        "read": 0.01,
        "coarse fit": 0.02,
        "network": 0.09,
        "relief spectrum": 0.045,
        "refine": 0.04,
        "inpaint": 0.03,
        "index": 0.03,
        "statistics": 0.035,
        "start": 0.005,
        "fine-tuning": 0.62,
        "matching": 0.025,
        "verdict": 0.035,
        "write": 0.015,
    }
)
_EXEMPLAR = ("network", "relief spectrum", "refine", "inpaint", "index")
_OTHERS = 1.0 - sum(DRAWING_STAGES[name] for name in _EXEMPLAR)
DECODER_STAGES: Mapping[str, float] = MappingProxyType(
    {name: share / _OTHERS for name, share in DRAWING_STAGES.items() if name not in _EXEMPLAR}
)


@dataclass(frozen=True)
class CaptureProgress(Progress):
    """Progress of a capture."""

    error: float | None = None
    """Texture distance in fine-tuning a decoder, over that between neighbouring windows of the
    photograph; None in other stages."""
    interrupted: bool = False
    """Whether Ctrl-C was pressed: the remaining stages complete the best result so far."""


class CaptureClock:
    """Times the stages of a capture and reports progress to a callback.

    Attributes:
        seconds: duration of each completed stage.
        interrupted: whether Ctrl-C was pressed.
    """

    def __init__(
        self,
        on_progress: Callable[[CaptureProgress], None] | None,
        stages: Mapping[str, float] = EXEMPLAR_STAGES,
        limit: float | None = None,
        spent: float = 0.0,
    ) -> None:
        """Start the clock.

        Args:
            on_progress: callback, or None.
            stages: names in order, each with its share of the time.
            limit: seconds for the whole command, or None.
            spent: seconds that the command has taken before.
        """
        self.seconds: dict[str, float] = {}
        self.interrupted = False
        self._on_progress = on_progress or ignore_progress
        self._bounds, self._limit = _bounds(stages), limit
        self._spent = spent
        self._started = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._started

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a `with` block as a stage, and report its begin and end."""
        began = time.monotonic()
        self._on_progress(self._now(name, 0.0))
        try:
            yield
        except KeyboardInterrupt:
            self.interrupted = True
            raise
        finally:
            self.seconds[name] = time.monotonic() - began
        self._on_progress(self._now(name, 1.0))

    def within(self, name: str, share: float) -> None:
        """Report that a share, in [0, 1], of a stage is complete."""
        self._on_progress(self._now(name, share))

    def callback(self, name: str, begin: float = 0.0, end: float = 1.0) -> Callable[[float], None]:
        """Callback for the part of a stage from `begin` to `end`; it takes a share in [0, 1]."""
        return lambda share: self.within(name, begin + share * (end - begin))

    def tuning(self, share: float, error: float) -> None:
        """Report a step of fine-tuning, with its error (see CaptureProgress); NaN is none."""
        now = self._now("fine-tuning", share)
        self._on_progress(replace(now, error=error if error == error else None))

    def left_for(self, name: str) -> float:
        """Seconds left for a stage: limit - t - t * after / before, at least 0; infinite without.

        t is the time taken so far; `before` and `after` are the shares of earlier and later stages.
        """
        if self._limit is None:
            return float("inf")
        before, until_end = self._bounds[name]
        after = 1.0 - until_end
        until = self._spent + self.elapsed
        return max(0.0, self._limit - until - until * after / max(before, 1e-6))

    def _now(self, name: str, share: float) -> CaptureProgress:
        begin, end = self._bounds[name]
        fraction = min(end, begin + share * (end - begin))
        elapsed = self.elapsed
        left = elapsed * (1.0 - fraction) / fraction if fraction > 0.15 else None
        return CaptureProgress(name, fraction, elapsed, left, interrupted=self.interrupted)


def _bounds(stages: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """(begin, end) of every stage, as fractions of the whole time.

    Each stage begins at exactly the float at which the previous one ends, so that rounding never
    lowers the progress.
    """
    ends = [min(1.0, end) for end in accumulate(stages.values())]
    return dict(zip(stages, pairwise([0.0, *ends]), strict=True))
