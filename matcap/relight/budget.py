"""Per-tile error budget: the tolerance left by the plan, shared among effects.

The tolerance is in code values, and what is known of a pixel's radiance already, all of which
adds up, says how much more of it such a step of code is: at code 0.5 eight times as much as at
black, where the curve is steepest. The curve is concave, so a change of radiance anywhere above
what is known changes the code by no more than its slope there says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from matcap.files.srgb import srgb_slope
from matcap.relight.scene import Film
from matcap.relight.vectors import Array

# How what is left is shared among those effects that are decided tile by tile and run. Area lights'
# is what their rules were measured to be off; hardly a pixel mirrors so little of its surroundings
# that any share would let it leave them out.
SHARES: Mapping[str, float] = {"area": 0.4, "environment": 0.05, "interreflection": 0.55}


@dataclass(frozen=True)
class Budget:
    """What may be left out in any one pixel."""

    codes: float
    """Code values from 0 to 1."""
    film: Film
    """Of the picture."""
    running: frozenset[str]
    """The effects that run."""

    def radiance(self, effect: str, known: Array) -> Array:
        """(3, ...) what an effect may change, where pixels are known to be as bright at least.

        Args:
            effect: a name in SHARES.
            known: (3, ...) radiance.
        """
        share = SHARES[effect] / sum(SHARES[one] for one in {effect, *self.running} & set(SHARES))
        allowed = np.float32(share * self.codes / self.film.gain)
        if self.film.transfer == "linear":
            return np.broadcast_to(allowed, known.shape)
        tolerance: Array = allowed / srgb_slope(known * np.float32(self.film.gain))
        return tolerance
