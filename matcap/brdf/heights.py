"""Validation of height maps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError

# Plane units. Squares of the slopes of such heights do not overflow single precision.
TALLEST = 1e6


def check_heights(height: NDArray[np.floating], where: str = "") -> None:
    """Refuse heights above TALLEST, in plane units; NaN and infinity are checked elsewhere.

    Raises:
        MatcapError: naming `where`.
    """
    most = float(np.abs(height).max(initial=0.0))
    if TALLEST < most < float("inf"):
        raise MatcapError.at(
            where,
            f"its height reaches {most:.2g} plane units, which no surface does",
            "make the material again",
        )
