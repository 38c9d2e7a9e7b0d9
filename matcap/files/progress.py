"""Progress reports of long-running work, passed to a callback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """Progress of long-running work."""

    stage: str
    """Name of the present stage."""
    fraction: float
    """Share of the work done, in [0, 1]."""
    seconds: float = 0.0
    """Since the start; 0 if not measured."""
    seconds_left: float | None = None
    """Expected remaining time, or None if unknown."""


OnProgress = Callable[[Progress], None]


def ignore_progress(now: Progress) -> None:
    """Callback that does nothing."""
