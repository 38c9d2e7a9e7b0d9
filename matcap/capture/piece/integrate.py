"""Least-squares integration of slopes to height ([frankot1988], by cosine transforms)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Heights2D = NDArray[np.float32]


def integrate(across: Heights2D, down: Heights2D) -> Heights2D:
    """(H, W) height of zero mean by least squares: the inverse of differences of neighbours.

    The Poisson equation with Neumann boundaries, solved by the discrete cosine transform.

    Args:
        across: (H, W - 1) rise from each texel to the one right of it.
        down: (H - 1, W) rise to the one below.
    """
    height, width = across.shape[0], down.shape[1]
    divergence = np.zeros((height + height % 2, width + width % 2), np.float32)
    # cv2.dct requires even sides; an added row or column of zero rise hardly changes the result.
    across, down = _even(across, (height % 2, width % 2)), _even(down, (height % 2, width % 2))
    divergence[:, :-1] += across
    divergence[:, 1:] -= across
    divergence[:-1] += down
    divergence[1:] -= down
    return np.ascontiguousarray(poisson(divergence)[:height, :width])


def poisson(divergence: Heights2D, across: float = 1.0, down: float = 1.0) -> Heights2D:
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


def _even(rise: Heights2D, more: tuple[int, int]) -> Heights2D:
    """Append `more` = (rows, columns) of zeros."""
    return np.pad(rise, [(0, more[0]), (0, more[1])])
