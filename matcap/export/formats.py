"""Pixel types in memory and file formats of textures."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Depth = Literal["8", "16", "half", "float"]
Container = Literal["png", "jpg", "exr"]
Picture = NDArray[np.float32]

CONTAINERS: dict[Container, tuple[Depth, ...]] = {
    "png": ("8", "16"),
    "jpg": ("8",),
    "exr": ("half", "float"),
}
NormalMaps = Literal["gl", "dx", "both"]  # +Y up, +Y down, or a file of each
# Rows processed together: with 4096 columns the working set fits the cache.
_BAND_ROWS = 64


def rgb(values: Picture) -> Picture:
    """(H, W, 3): grey (H, W) is repeated."""
    return np.repeat(values[..., None], 3, axis=2) if values.ndim == 2 else values


def brightest_channel(values: Picture) -> Picture:
    """(H, W) maximum over channels of (H, W[, 3])."""
    return values if values.ndim == 2 else values.max(axis=-1)


def mean_channel(values: Picture) -> Picture:
    """(H, W) mean over channels of (H, W[, 3])."""
    return values if values.ndim == 2 else values.mean(axis=-1)


def bands(height: int) -> list[slice]:
    """Slices of _ROWS rows that cover a picture."""
    return [slice(top, min(top + _BAND_ROWS, height)) for top in range(0, height, _BAND_ROWS)]
