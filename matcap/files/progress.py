"""Progress reports of long-running work, passed to a callback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far work is."""

    stage: str
    """What is done now."""
    fraction: float
    """Of the whole, in [0, 1]."""
    seconds: float = 0.0
    """Since the start; 0 where it is not measured."""
    seconds_left: float | None = None
    """Expected, or None where it is too early to say."""


OnProgress = Callable[[Progress], None]


def nobody(now: Progress) -> None:
    """Listens."""
