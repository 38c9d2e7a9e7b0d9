"""The sRGB transfer function, encoding (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def srgb_encode(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear light to sRGB code values, any shape; both in [0, 1], clipped there."""
    clipped = np.clip(linear, 0.0, 1.0)
    curve = 1.055 * np.power(np.maximum(clipped, 0.0031308), 1.0 / 2.4) - 0.055
    return np.where(clipped <= 0.0031308, 12.92 * clipped, curve).astype(np.float32)
