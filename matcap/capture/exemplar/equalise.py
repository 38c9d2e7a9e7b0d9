"""Relief of one strength everywhere: a stationary sample's slopes do not know where the flash was.

A network shrinks what is in doubt, and relief is in doubt under the flash's foot, so that relit
pictures show a bull's-eye. Band by band, the height's slopes are brought to the strength that the
whole photograph tells (strengths.py), and to the same strength in every neighbourhood.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Height = NDArray[np.float32]

# Deviations in texels of the blurs between bands; about the bands of strengths.BANDS.
BLURS = (1.0, 2.0, 4.0, 8.0, 16.0)
_AROUND = 64.0  # texels: deviation of a neighbourhood
_GAINS = (0.3, 4.0)  # a band is not weakened or strengthened more than this


def equalise(height: Height, strengths: Sequence[float] | None, *, evenly: float = 1.0) -> Height:
    """A height (H, W) in texels of even slopes.

    Args:
        height: as the network gives it.
        strengths: root-mean-square slope wanted of each band, finest first, the rest last
            (band_strengths); None keeps each band's own on the whole.
        evenly: 0 for one gain a band, 1 for the same strength in every neighbourhood.
    """
    bands = split(height)
    even = np.zeros_like(height)
    for index, band in enumerate(bands):
        energy = _energy(band)
        whole = float(np.sqrt(energy.mean())) + 1e-6
        wanted = whole if strengths is None else strengths[index]
        around = max(_AROUND, 2.0 * BLURS[min(index, len(BLURS) - 1)])
        local = np.sqrt(cv2.GaussianBlur(energy, (0, 0), around)) + 1e-6
        gain = wanted / (whole ** (1.0 - evenly) * local**evenly)
        even += band * np.clip(gain, *_GAINS)
    return even


def split(height: Height) -> list[Height]:
    """Bands of a height, finest first, and the rest; they add up to it."""
    bands = []
    for blur in BLURS:
        smooth = cv2.GaussianBlur(height, (0, 0), blur)
        bands.append(height - smooth)
        height = smooth
    return [*bands, height]


def band_strengths(height: Height) -> list[float]:
    """Root-mean-square slope of each band."""
    return [float(np.sqrt(_energy(band).mean())) for band in split(height)]


def _energy(height: Height) -> Height:
    down, across = np.gradient(height)
    return np.asarray(down**2 + across**2, np.float32)
