"""Colour spaces: Rec.709, the sRGB curve, and conversions of code values to linear light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

# Rec.709 primaries and luminance, and conversion from other primaries (ITU-R BT.709-6).
#
# Every linear colour in matcap is Rec.709 with the white point D65.

Matrix = NDArray[np.float64]

# Chromaticities x, y of red, green, blue and white (ITU-R BT.709-6; D65).
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
# Luminance of linear red, green and blue (BT.709-6, item 3.2): white is 1.
LUMINANCE = (0.2126, 0.7152, 0.0722)

# Primaries of CIE XYZ values stored as red X, green Y, blue Z.
XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0 / 3.0, 1.0 / 3.0)
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
_SAME = 2e-3  # tolerance of coefficients, for primaries rounded to two digits


def rec709_from(primaries: Sequence[float]) -> Matrix | None:
    """(3, 3) matrix from linear colours of other primaries to Rec.709; None for the identity.

    White is adapted to D65 by the Bradford transform [lam1985], as in ICC profiles. CIE XYZ values
    are taken as relative to D65, whose white is (0.9505, 1, 1.089).

    Args:
        primaries: x, y of red, green, blue and white, as an EXR file's `chromaticities`.

    Raises:
        ValueError: the primaries are no basis of colours.
    """
    given = np.asarray(primaries, np.float64)
    if given.shape != (8,) or not np.isfinite(given).all():
        raise ValueError("the primaries are not eight finite numbers")
    if np.abs(given[:6] - XYZ[:6]).max() < _SAME:
        return np.asarray(np.linalg.inv(_to_xyz(np.array(REC709))))
    own, target = _to_xyz(given), _to_xyz(np.array(REC709))
    white = own.sum(axis=1)
    scale = (_BRADFORD @ target.sum(axis=1)) / (_BRADFORD @ white)
    adapted = np.linalg.solve(_BRADFORD, scale[:, None] * (_BRADFORD @ own))
    matrix = np.linalg.solve(target, adapted)
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 100.0:
        raise ValueError("the primaries do not span a colour space")
    matrix /= matrix.sum(axis=1, keepdims=True)  # grey stays grey, to the last bit
    return None if np.abs(matrix - np.eye(3)).max() < _SAME else np.asarray(matrix, np.float64)


def _to_xyz(given: Matrix) -> Matrix:
    """(3, 3) matrix from linear colours to XYZ, with Y = 1 for white (SMPTE RP 177)."""
    x, y = given[0::2], given[1::2]
    if abs(y[3]) < 1e-6:
        raise ValueError("white has no luminance")
    axes = np.stack([x[:3], y[:3], 1.0 - x[:3] - y[:3]])
    if abs(float(np.linalg.det(axes))) < 1e-6:
        raise ValueError("the primaries lie on a line")
    white = np.array([x[3] / y[3], 1.0, (1.0 - x[3] - y[3]) / y[3]])
    return np.asarray(axes * np.linalg.solve(axes, white))


# The sRGB transfer function between linear light and code values (IEC 61966-2-1).
#
# code = 12.92 light for light <= 0.0031308, else 1.055 light^(1/2.4) - 0.055. Light 0.5 is code
# 0.735357, and code 0.5 is light 0.214041. Values below 0 and above 1 are extrapolated by the same
# formulas. Derivatives are finite everywhere. For NumPy and PyTorch.

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
    return srgb_encode(np.clip(linear, 0.0, 1.0).astype(np.float32, copy=False))


def srgb_slope(light: CodeValues) -> CodeValues:
    """Derivative of the code by light, any shape: 12.92 near black, 0.439583 at light 1."""
    power = np.maximum(light, _KNEE_LIGHT) ** light.dtype.type(1.0 / 2.4 - 1.0)
    return np.where(light <= _KNEE_LIGHT, light.dtype.type(12.92), power * (1.055 / 2.4))


# Colour spaces of files: transfer functions and matrices from code values to linear Rec.709.
#
# A file states its colour space by an ICC profile (stated_color.py), by code points (ITU-T H.273:
# cICP in PNG, nclx in HEIC and AVIF) or by primaries and an exponent (gAMA and cHRM in PNG). Each
# becomes a ColorSpace. The sRGB curve is in color.py, primaries are in color.py.
#
# Display-referred codes (sRGB, PQ, HLG) become display light in units of diffuse white: 203 cd/m2
# for PQ, and for HLG on a display of 1000 cd/m2 (ITU-R BT.2408, table 1).

Values = NDArray[np.float64]
Curve = Callable[[Values], Values]
Linearise = Callable[[NDArray[np.generic]], NDArray[np.float32]]

# Linear Rec.709 to XYZ relative to D50, Bradford-adapted: the colorants of sRGB's ICC profile.
REC709_TO_D50 = np.array(
    [
        [0.4360747, 0.3850649, 0.1430804],
        [0.2225045, 0.7168786, 0.0606169],
        [0.0139322, 0.0971045, 0.7141733],
    ]
)


def largest_code(dtype: np.dtype[Any]) -> float:
    """The largest code value of a type: of integers their largest, of floats 1."""
    return float(np.iinfo(dtype).max) if np.issubdtype(dtype, np.integer) else 1.0


def linear(code: Values) -> Values:
    """Transfer function of a file of linear light."""
    return code


@dataclass(frozen=True)
class ColorSpace:
    """Colour space of a file."""

    name: str
    """For reports and notes."""
    curves: tuple[Curve, Curve, Curve]
    """Transfer functions of red, green and blue, from code values in [0, 1] to linear light."""
    matrix: Values | None = None
    """(3, 3) from the file's linear colours to Rec.709; None is the identity."""
    system_gamma: float = 1.0
    """Exponent of luminance from scene to display light (HLG; ITU-R BT.2100, table 5)."""

    def lineariser(self, dtype: np.dtype[np.generic]) -> Linearise:
        """A function from rows (n, W, 3) of this dtype to linear Rec.709, float32, at least 0.

        Integers are converted by a table of all code values. Colours outside Rec.709 are clipped at
        0, but not at 1.
        """
        curves, exponent = self.curves, self.system_gamma - 1.0
        luminance = np.array(LUMINANCE, np.float32)
        matrix = None if self.matrix is None else self.matrix.T.astype(np.float32)

        def finish(light: NDArray[np.float32]) -> NDArray[np.float32]:
            turned = light if matrix is None else light @ matrix
            np.maximum(turned, 0.0, out=turned)
            if exponent:
                turned *= (turned @ luminance)[..., None] ** np.float32(exponent)
            return turned

        if not np.issubdtype(dtype, np.integer):

            def from_floats(rows: NDArray[np.generic]) -> NDArray[np.float32]:
                channels = [curves[c](rows[..., c].astype(np.float64)) for c in range(3)]
                return finish(np.stack(channels, axis=-1).astype(np.float32))

            return from_floats

        largest = int(np.iinfo(dtype).max)  # type: ignore[type-var]
        codes = np.arange(largest + 1, dtype=np.float64) / largest
        tables = [curve(codes).astype(np.float32) for curve in curves]

        def from_integers(rows: NDArray[np.generic]) -> NDArray[np.float32]:
            light = np.empty(rows.shape, np.float32)
            for channel, table in enumerate(tables):
                light[..., channel] = table[rows[..., channel]]
            return finish(light)

        def from_bytes(rows: NDArray[np.generic]) -> NDArray[np.float32]:
            import cv2  # looks up bytes, and them alone, in a tenth of the time

            return finish(np.asarray(cv2.LUT(np.asarray(rows), np.stack(tables, axis=-1)[None])))

        return from_bytes if largest == 255 else from_integers


SRGB = ColorSpace("sRGB", (srgb_decode,) * 3)
LINEAR = ColorSpace("linear Rec.709", (linear,) * 3)

# (name, primaries and white) by code point (ITU-T H.273, table 2) that cameras and renderers write.
_PRIMARIES: dict[int, tuple[str, tuple[float, ...]]] = {
    1: ("Rec.709", REC709),
    5: ("BT.470 BG", (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, 0.3127, 0.3290)),
    6: ("SMPTE 170M", (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, 0.3127, 0.3290)),
    9: ("BT.2020", (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)),
    12: ("Display P3", (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)),
}
_UNSPECIFIED = 2  # a code point
_WHITE = 203.0  # cd/m2, diffuse white (ITU-R BT.2408, table 1)
_HLG_PEAK, _HLG_GAMMA = 1000.0, 1.2  # cd/m2 and system gamma (ITU-R BT.2100, table 5)


def power(exponent: float) -> Curve:
    """The curve light = code^exponent, 0 for negative codes."""
    return lambda code: np.maximum(code, 0.0) ** exponent


def rec709_decode(code: Values) -> Values:
    """Inverse of the camera's curve of ITU-R BT.709-6, item 1.2; code 0.5 is the light 0.2597."""
    above = (np.maximum(code, 0.081) + 0.099) / 1.099
    return np.where(code < 0.081, code / 4.5, above ** (1.0 / 0.45))


def pq_decode(code: Values) -> Values:
    """SMPTE ST 2084 (ITU-R BT.2100, table 4), in parts of 203 cd/m2; code 0.5806 is the light 1."""
    m1, m2 = 2610.0 / 16384.0, 2523.0 / 4096.0 * 128.0
    c1, c2, c3 = 3424.0 / 4096.0, 2413.0 / 4096.0 * 32.0, 2392.0 / 4096.0 * 32.0
    root = np.clip(code, 0.0, 1.0) ** (1.0 / m2)
    light = (np.maximum(root - c1, 0.0) / (c2 - c3 * root)) ** (1.0 / m1)
    return light * (10_000.0 / _WHITE)


def hlg_decode(code: Values) -> Values:
    """Hybrid log-gamma to scene light (ITU-R BT.2100, table 5), in parts of that of diffuse white.

    With the system gamma applied to luminance, code 0.75 is 203 cd/m2 on a display of 1000.
    """
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    clipped = np.clip(code, 0.0, 1.0)
    scene = np.where(clipped <= 0.5, clipped**2 / 3.0, (np.exp((clipped - c) / a) + b) / 12.0)
    return scene / (_WHITE / _HLG_PEAK) ** (1.0 / _HLG_GAMMA)


# Curves by code point (ITU-T H.273, table 3).
_TRANSFERS: dict[int, tuple[str, Curve]] = {
    **dict.fromkeys((1, 6, 14, 15), ("the curve of BT.709", rec709_decode)),
    8: ("linear", linear),
    13: ("the curve of sRGB", srgb_decode),
    16: ("PQ", pq_decode),
    18: ("HLG", hlg_decode),
}


def space_of_code_points(primaries: int, transfer: int) -> ColorSpace | None:
    """The colour space of ITU-T H.273's code points; None if one of them is unknown.

    Unspecified code points are taken as sRGB's (ISO/IEC 23000-22).
    """
    primaries = 1 if primaries == _UNSPECIFIED else primaries
    transfer = 13 if transfer == _UNSPECIFIED else transfer
    if primaries not in _PRIMARIES or transfer not in _TRANSFERS:
        return None
    (name, corners), (transfer_name, curve) = _PRIMARIES[primaries], _TRANSFERS[transfer]
    if (primaries, transfer) == (1, 13):
        return SRGB
    gamma = _HLG_GAMMA if curve is hlg_decode else 1.0
    return ColorSpace(f"{name}, {transfer_name}", (curve,) * 3, rec709_from(corners), gamma)


def space_of_primaries(primaries: Sequence[float] | None, curve: Curve, name: str) -> ColorSpace:
    """The colour space of primaries (as in rec709_from) and a transfer function.

    Raises:
        ValueError: the primaries are no basis of colours.
    """
    matrix = None if primaries is None else rec709_from(primaries)
    return ColorSpace(name, (curve,) * 3, matrix)


# Adobe RGB (1998), section 4.3; "R03" in Exif (DCF 2.0).
ADOBE_RGB = space_of_primaries(
    (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290), power(563.0 / 256.0), "Adobe RGB (1998)"
)


def converted(space: ColorSpace) -> tuple[str, ...]:
    """Notes to the user on the conversion from this colour space; none for sRGB."""
    if space is SRGB or space is LINEAR:
        return ()
    return (f"Colours converted from the file's {space.name} to Rec.709.",)


def assumed(space: ColorSpace, what: str) -> str:
    """Note to the user that `space` is assumed, as the file's statement cannot be read."""
    return f"The file's {what} cannot be read: {space.name} assumed."
