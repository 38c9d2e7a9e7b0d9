"""Upper bound on the change from leaving an effect out."""

from __future__ import annotations

from dataclasses import dataclass

# Half a step of an 8-bit picture: what leaving effects out may change by default.
DEFAULT_TOLERANCE = 0.5 / 255.0


@dataclass(frozen=True)
class Bound:
    """An upper bound, anywhere in the picture."""

    radiance: float
    """How much any channel of any pixel could change; may be infinite."""
    reason: str
    """Why, in a few words."""
