"""Linear pictures as sRGB code values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.photo import color


def srgb_encode(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear light to sRGB code values, any shape; both in [0, 1], clipped there."""
    clipped = np.clip(linear, 0.0, 1.0).astype(np.float64)
    return color.srgb_encode(clipped).astype(np.float32)
