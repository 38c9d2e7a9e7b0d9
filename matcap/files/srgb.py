"""The sRGB curve, between linear light and code values (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

# Where the sRGB curve changes from line to power, in code values and in light.
_KNEE_CODE, _KNEE_LIGHT = 0.04045, 0.0031308


def srgb_decode(code: Values) -> Values:
    """From sRGB code values to linear light, any shape; slope 1/12.92 at 0 and below it."""
    power = ((np.maximum(code, _KNEE_CODE) + 0.055) / 1.055) ** 2.4
    return np.where(code <= _KNEE_CODE, code / 12.92, power)


def srgb_encode(light: Values) -> Values:
    """From linear light to sRGB code values, any shape; slope 12.92 at 0 and below it."""
    power = 1.055 * np.maximum(light, _KNEE_LIGHT) ** (1.0 / 2.4) - 0.055
    return np.where(light <= _KNEE_LIGHT, light * 12.92, power)


def srgb_picture(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear light to sRGB code values, any shape; both in [0, 1], clipped there."""
    clipped = np.clip(linear, 0.0, 1.0).astype(np.float64)
    return srgb_encode(clipped).astype(np.float32)
