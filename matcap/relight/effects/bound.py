"""What leaving an effect out could change."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Bound:
    """An upper bound, anywhere in the picture.

    Attributes:
        radiance: how much any channel of any pixel could change; may be infinite.
        reason: why, in a few words.
    """

    radiance: float
    reason: str
