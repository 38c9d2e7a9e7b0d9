"""Pixel types in memory and file formats of textures."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Depth = Literal["8", "16", "half", "float"]
Container = Literal["png", "jpg", "webp", "exr", "tx"]
Picture = NDArray[np.float32]

CONTAINERS: dict[Container, tuple[Depth, ...]] = {
    "png": ("8", "16"),
    "jpg": ("8",),
    "webp": ("8",),
    "exr": ("half", "float"),
    "tx": ("8", "16", "half", "float"),
}
# Rows of a picture that are made at a time: of 4096 columns what is worked on stays in the cache.
_ROWS = 64


def rgb(values: Picture) -> Picture:
    """(H, W, 3) of what may be grey, (H, W)."""
    return np.repeat(values[..., None], 3, axis=2) if values.ndim == 2 else values


def brightest_channel(values: Picture) -> Picture:
    """(H, W) of what may have a colour, (H, W, 3)."""
    return values if values.ndim == 2 else values.max(axis=-1)


def mean_channel(values: Picture) -> Picture:
    """(H, W) of what may have a colour, (H, W, 3)."""
    return values if values.ndim == 2 else values.mean(axis=-1)


def bands(height: int) -> list[slice]:
    """The rows of a picture, as many at a time as are made at once."""
    return [slice(top, min(top + _ROWS, height)) for top in range(0, height, _ROWS)]
