"""Error budget of single pixels: the tolerance that the plan has left, shared among effects.

The tolerance is in code values. Radiance only adds up, so the radiance L of a pixel so far is a
lower bound of the final one. The sRGB curve f is concave: a change d anywhere above L changes the
code by no more than f'(L) d. A pixel may thus lose tolerance / f'(L), eight times as much at code
0.5 as at black.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from matcap.files.srgb import srgb_slope
from matcap.relight.scene import Film
from matcap.relight.vectors import Array

# Shares of the budget. That of area lights is the measured error of their quadrature. Hardly a
# pixel mirrors so little of an environment that a larger share would let it leave that out.
SHARES: Mapping[str, float] = {"area": 0.4, "environment": 0.05, "interreflection": 0.55}


@dataclass(frozen=True)
class Budget:
    """Error that each pixel may have."""

    codes: float
    """Tolerance left, in code values, [0, 1]."""
    film: Film
    """Exposure and transfer of the picture."""
    running: frozenset[str]
    """Names of the effects that run."""

    def radiance(self, effect: str, known: Array) -> Array:
        """(3, ...) radiance that leaving an effect out may change.

        Args:
            effect: a name in SHARES.
            known: (3, ...) radiance of the pixels so far.
        """
        share = SHARES[effect] / sum(SHARES[one] for one in {effect, *self.running} & set(SHARES))
        allowed = np.float32(share * self.codes / self.film.gain)
        if self.film.transfer == "linear":
            return np.broadcast_to(allowed, known.shape)
        tolerance: Array = allowed / srgb_slope(known * np.float32(self.film.gain))
        return tolerance
