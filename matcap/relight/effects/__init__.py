"""Effects of the renderer, one a file; direct.py has the three of every light.

Each file states the formula with its source, the picture without the effect ("Left out"), the cost,
and `bound(limits)`: a rigorous upper bound, in radiance, on the change from leaving it out.
render.py decides from the bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

# Largest change from leaving effects out, by default: half an 8-bit step, in code values [0, 1].
DEFAULT_TOLERANCE = 0.5 / 255.0


@dataclass(frozen=True)
class Bound:
    """An upper bound on the change of a picture."""

    radiance: float
    """Largest change of any channel of any pixel; may be infinite."""
    reason: str
    """The quantity that decides it, in a few words, for the table of the plan."""
