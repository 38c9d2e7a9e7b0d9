"""Height from slopes by integration [frankot1988], for normal maps without a height map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def integrated(slopes: NDArray[np.floating], texel_size: float = 1.0) -> NDArray[np.float32]:
    """(1, H, W) periodic height of mean 0 whose slopes fit given ones by least squares.

    In the Fourier domain H = -i (w . S) / |w|^2. The slopes' means and curl, which no periodic
    surface has, do not contribute.

    Args:
        slopes: (2, H, W) dh/dx and dh/dy, y upwards, row 0 at the top.
        texel_size: a texel's side, in the unit of the height.
    """
    rows, columns = slopes.shape[1:]
    wx = 2.0 * np.pi * np.fft.fftfreq(columns)[None, :] / texel_size
    wy = -2.0 * np.pi * np.fft.fftfreq(rows)[:, None] / texel_size
    squared = wx * wx + wy * wy
    squared[0, 0] = 1.0
    spectrum = -1j * (wx * np.fft.fft2(slopes[0]) + wy * np.fft.fft2(slopes[1])) / squared
    spectrum[0, 0] = 0.0
    return np.fft.ifft2(spectrum).real[None].astype(np.float32)
