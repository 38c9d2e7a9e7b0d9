"""Coordinates on the endless plane: periods, seeds and spans, with their limits.

Imports no PyTorch, for a fast start.
"""

from __future__ import annotations

from dataclasses import dataclass

from matcap.errors import UsageError
from matcap.files.values import COORDINATE_LIMIT as COORDINATE_LIMIT
from matcap.files.values import SEED_LIMIT
from matcap.files.values import Rectangle as Rectangle

# Period of a field in texels along x and y; None for an axis along which it never repeats.
Period = tuple[int | None, int | None]


def check_seed(seed: int) -> int:
    """Return the seed; raise UsageError outside [-2^63, 2^63)."""
    if not -SEED_LIMIT <= seed < SEED_LIMIT:
        raise UsageError(f"the seed {seed} is out of range", remedy="give one in [-2^63, 2^63)")
    return seed


def check_variety(variety: float) -> float:
    """Return the variety; raise UsageError outside [0, 1]."""
    if not 0.0 <= variety <= 1.0:
        raise UsageError.at(
            "--variety", f"a variety of {variety:g} is out of range", "give a number from 0 to 1"
        )
    return variety


def check_period(period: Period | None, alignment: int) -> Period | None:
    """Return the period; raise UsageError unless each is a positive multiple of the alignment."""
    for length in period or ():
        if length is not None and (length <= 0 or length % alignment):
            raise UsageError(
                f"the period {length} is not a positive multiple of {alignment}",
                remedy=f"round it to a multiple of {alignment}",
            )
    return period


@dataclass(frozen=True)
class Span:
    """Texels [start, stop) along one axis."""

    start: int
    stop: int

    def grown(self, margin: int) -> Span:
        """The span extended by `margin` texels at both ends."""
        return Span(self.start - margin, self.stop + margin)

    def doubled(self) -> Span:
        """The span in texels of the next finer level."""
        return Span(2 * self.start, 2 * self.stop)

    @property
    def size(self) -> int:
        """Number of texels."""
        return self.stop - self.start

    def within(self, outer: Span) -> slice:
        """Slice of this span in an array that covers `outer`."""
        return slice(self.start - outer.start, self.stop - outer.start)
