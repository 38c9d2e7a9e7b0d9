"""Decoded: what a reader hands to load_photo, before the picture is turned and judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Decoded:
    """A picture in linear light, lying as the file stores it.

    Attributes:
        pixels: (h, w, 3) float32 linear Rec.709, at least 0, already shrunk to the long side.
        clipped: (h, w) bool.
        size: (width, height) as stored, before shrinking.
        orientation: EXIF's 1 to 8, still to be applied.
        radiometric: proportional to light.
        gain_map_applied: a DNG lens-shading map was applied.
        notes: sentences for the report.
        clipped_share: of the stored pixels (of a RAW: of the photosites of the colour that clips
            most), before shrinking, or None where only `clipped` is known.
        noise: like pixels, see Photo.
        balance: see Photo.
        opacity: (h, w) float32 in [0, 1], or None where everything is opaque.
    """

    pixels: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    size: tuple[int, int]
    orientation: int = 1
    radiometric: bool = False
    gain_map_applied: bool = False
    notes: tuple[str, ...] = ()
    clipped_share: float | None = None
    noise: NDArray[np.float32] | None = None
    balance: tuple[float, float, float] | None = None
    opacity: NDArray[np.float32] | None = None
