"""A height field read by NumPy, plainly: what matcap.relight.loops is held to."""

import numpy as np

from matcap.relight.relief import Relief


def at(relief: Relief, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Heights at places (u, v) in plane units, float32."""
    width, height = relief.texture.size
    column, row = relief.texels(u, v)
    left, above = np.floor(column), np.floor(row)
    fx, fy = (column - left).astype(np.float32), (row - above).astype(np.float32)
    field = relief.heights.reshape(height, width)
    x0, y0 = np.mod(left.astype(int), width), np.mod(above.astype(int), height)
    x1, y1 = (x0 + 1) % width, (y0 + 1) % height
    upper = field[y0, x0] + fx * (field[y0, x1] - field[y0, x0])
    lower = field[y1, x0] + fx * (field[y1, x1] - field[y1, x0])
    return upper + fy * (lower - upper)


def nearest(relief: Relief, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Indices of the texels nearest to places."""
    width, height = relief.texture.size
    column, row = (np.rint(c).astype(int) for c in relief.texels(u, v))
    return np.mod(row, height) * width + np.mod(column, width)
