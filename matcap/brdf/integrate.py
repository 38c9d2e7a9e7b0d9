"""Height from slopes by least squares [frankot1988]: periodic, or with free borders.

A map set that tiles is integrated by Fourier transforms, the relief of a photographed rectangle,
whose opposite borders do not fit, by cosine transforms.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

HeightPlane = NDArray[np.float32]


def integrate_periodic(slopes: NDArray[np.floating], texel_size: float = 1.0) -> HeightPlane:
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


def integrate(across: HeightPlane, down: HeightPlane) -> HeightPlane:
    """(H, W) height of zero mean by least squares: the inverse of differences of neighbours.

    The Poisson equation with Neumann boundaries, solved by the discrete cosine transform.

    Args:
        across: (H, W - 1) rise from each texel to the one right of it.
        down: (H - 1, W) rise to the one below.
    """
    height, width = across.shape[0], down.shape[1]
    divergence = np.zeros((height + height % 2, width + width % 2), np.float32)
    # cv2.dct requires even sides; an added row or column of zero rise hardly changes the result.
    added = [(0, height % 2), (0, width % 2)]
    across, down = np.pad(across, added), np.pad(down, added)
    divergence[:, :-1] += across
    divergence[:, 1:] -= across
    divergence[:-1] += down
    divergence[1:] -= down
    return np.ascontiguousarray(poisson(divergence)[:height, :width])


def poisson(divergence: HeightPlane, across: float = 1.0, down: float = 1.0) -> HeightPlane:
    """Solve across d2h/dx2 + down d2h/dy2 = divergence for h (H, W), texels, of zero mean.

    Second differences, Neumann boundaries.
    """
    rows, columns = (
        2.0 * np.cos(np.pi * np.arange(side) / side) - 2.0 for side in divergence.shape
    )
    laplacian = down * rows[:, None] + across * columns
    laplacian[0, 0] = 1.0
    waves = cv2.dct(divergence) / laplacian.astype(np.float32)
    waves[0, 0] = 0.0
    return np.asarray(cv2.idct(waves), np.float32)
