"""How far work is: what everything that takes long tells whoever shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far work is.

    Attributes:
        stage: what is done now.
        fraction: of the whole, in [0, 1].
        seconds: since the start; 0 where nobody counts.
        seconds_left: expected, or None where it is too early to say.
    """

    stage: str
    fraction: float
    seconds: float = 0.0
    seconds_left: float | None = None


TellProgress = Callable[[Progress], None]


def nobody(now: Progress) -> None:
    """Listens."""
