"""Decoded: a reader's result, before load_photo orients and checks it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Decoded:
    """A linear picture, in the orientation in which the file stores it.

    Attributes:
        pixels: (h, w, 3) float32 linear Rec.709, at least 0, downsampled.
        clipped: (h, w) bool.
        size: (width, height) as stored, before downsampling.
        orientation: EXIF's 1 to 8, not yet applied.
        radiometric: whether values are proportional to radiance.
        linear: whether codes are proportional to light, so that a tone curve is unlikely.
        gain_map_applied: whether a DNG lens-shading map was applied.
        notes: sentences for the report.
        clipped_share: share of the stored pixels (of a RAW: of the photosites of the colour that
            clips most) at the clip level, or None if only `clipped` is known.
        noise: (h, w, 3), see Photo.
        balance: see Photo.
        opacity: (h, w) float32 in [0, 1], or None if all is opaque.
    """

    pixels: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    size: tuple[int, int]
    orientation: int = 1
    radiometric: bool = False
    linear: bool = False
    gain_map_applied: bool = False
    notes: tuple[str, ...] = ()
    clipped_share: float | None = None
    noise: NDArray[np.float32] | None = None
    balance: tuple[float, float, float] | None = None
    opacity: NDArray[np.float32] | None = None
