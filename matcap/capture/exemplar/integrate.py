"""Heights whose slopes are nearest to given ones (Frankot and Chellappa 1988, with cosines)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]


def integrate(slope_x: Field, slope_y: Field) -> Field:
    """(H, W) height of zero mean, in texels, by least squares.

    The Poisson equation with nothing passing the borders, solved by the discrete cosine transform.

    Args:
        slope_x: (H, W) dh/dx per texel, x to the right.
        slope_y: (H, W) dh/dy per texel, y upwards (rows run downwards).
    """
    height, width = slope_x.shape
    # cv2.dct wants even sides; a mirrored row or column changes next to nothing.
    p = _even(slope_x)
    q = _even(-slope_y)
    # Differences between texels are means of both texels' slopes.
    across, down = (p[:, 1:] + p[:, :-1]) / 2.0, (q[1:] + q[:-1]) / 2.0
    divergence = np.zeros_like(p)
    divergence[:, :-1] += across
    divergence[:, 1:] -= across
    divergence[:-1] += down
    divergence[1:] -= down
    rows = 2.0 * np.cos(np.pi * np.arange(p.shape[0]) / p.shape[0]) - 2.0
    columns = 2.0 * np.cos(np.pi * np.arange(p.shape[1]) / p.shape[1]) - 2.0
    laplacian = rows[:, None] + columns
    laplacian[0, 0] = 1.0
    waves = cv2.dct(divergence) / laplacian.astype(np.float32)
    waves[0, 0] = 0.0
    return np.ascontiguousarray(cv2.idct(waves)[:height, :width])


def _even(field: Field) -> Field:
    return np.pad(field, [(0, side % 2) for side in field.shape], mode="edge")
