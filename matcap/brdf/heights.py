"""Validation of height maps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError

# Plane units. Slopes of such heights still have squares in single precision, and so normals.
TALLEST = 1e6


def check_heights(height: NDArray[np.floating], where: str = "") -> None:
    """Raise MatcapError if heights, in plane units, are none of a surface.

    NaN and infinity are checked for every map elsewhere.
    """
    most = float(np.abs(height).max(initial=0.0))
    if TALLEST < most < float("inf"):
        raise MatcapError(
            f"its height reaches {most:.2g} plane units, which no surface does",
            where=where,
            remedy="make the material again",
        )
