"""Rec.709 primaries and luminance, and conversion from other primaries (ITU-R BT.709-6).

Every linear colour in matcap is Rec.709 with the white point D65.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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
