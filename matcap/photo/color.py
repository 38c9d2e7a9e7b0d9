"""From code values to linear Rec.709: transfer functions, and the colour space of a file.

Source: ITU-R BT.709-6 (primaries). The sRGB curve is files/srgb.py; profiles are read by `icc`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.files.srgb import srgb_decode

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


def linear(code: Values) -> Values:
    """The curve of a file that stores light itself."""
    return code


@dataclass(frozen=True)
class ColorSpace:
    """How a file's code values stand for light.

    Attributes:
        name: for the report.
        curves: code values in [0, 1] to linear light, one for each of red, green and blue.
        matrix: (3, 3) from the file's linear colours to Rec.709, or None where they are that.
    """

    name: str
    curves: tuple[Curve, Curve, Curve]
    matrix: Values | None = None

    def lineariser(self, dtype: np.dtype[np.generic]) -> Linearise:
        """A function from rows (n, W, 3) of this dtype to linear Rec.709 float32, at least 0.

        Integers go through a table of every code value, so that nothing of full size is ever made
        in floating point. Colours outside Rec.709 come out at 0 or above 1 in a channel.
        """
        curves = self.curves
        matrix = None if self.matrix is None else self.matrix.T.astype(np.float32)

        def finish(light: NDArray[np.float32]) -> NDArray[np.float32]:
            turned = light if matrix is None else light @ matrix
            return np.maximum(turned, 0.0, out=turned)

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
