"""The four words of a verdict."""

from __future__ import annotations

from enum import Enum


class Rating(Enum):
    """How good a capture is, for what one does with it.

    Attributes:
        GOOD: like the photograph; use it.
        USABLE: one sees differences beside the photograph only.
        DOUBTFUL: one sees that something is wrong; look before using it.
        FAILED: another material than the photographed one.
    """

    GOOD = "good"
    USABLE = "usable"
    DOUBTFUL = "doubtful"
    FAILED = "failed"

    @staticmethod
    def of(severity: float) -> Rating:
        """The word for a severity: up to 1 good, 2 usable, 3 doubtful, beyond failed."""
        order = list(Rating)
        return next(
            (word for limit, word in enumerate(order[:-1], 1) if severity <= limit), Rating.FAILED
        )
