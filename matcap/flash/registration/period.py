"""Test for periodic patterns, whose matches are ambiguous by whole periods.

What decides between places a period apart is what no period repeats: clouds, flaws, a border.
Where there is too little of that, matches agree with none.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from matcap.photo.photo import Photo


@dataclass(frozen=True)
class PeriodSettings:
    """When a pattern counts as repeating itself."""

    across: int = 640
    """Pixels that are looked at."""
    fine: float = 0.8
    slow: float = 12.0
    """Pixels: deviations of noise and of light, which are left out."""
    nearest: int = 4
    """Pixels: what lies nearer is like itself for being smooth."""
    reach: float = 0.2
    """Share of the long side up to which periods are looked for."""
    alike: float = 0.35
    """Correlation with itself a period further, at least; of leather, stone and plaster it is below
    0.07, of most weaves 0.46 to 0.94 (docs/notes/several.md)."""


PERIOD = PeriodSettings()


def repeats_itself(photo: Photo) -> bool:
    """Whether what a photograph shows is as it is some way further again."""
    return likeness_further(photo) > PERIOD.alike


def likeness_further(photo: Photo) -> float:
    """Highest correlation of a photograph's texture with itself some way further, at most 1."""
    rows, columns = photo.pixels.shape[:2]
    wide = min(columns, PERIOD.across)
    size = (wide, round(wide * rows / columns))
    grey = cv2.resize(photo.pixels.mean(2), size, interpolation=cv2.INTER_AREA)
    log = np.log(np.maximum(grey, 1e-5)).astype(np.float32)
    texture = cv2.GaussianBlur(log, (0, 0), PERIOD.fine) - cv2.GaussianBlur(
        log, (0, 0), PERIOD.slow
    )
    texture -= texture.mean()
    fields = [texture, np.ones_like(texture)]
    whole = tuple(2 * side for side in texture.shape)
    alike, shared = (
        np.fft.irfft2(np.abs(np.fft.rfft2(each, whole)) ** 2, whole) for each in fields
    )
    reach = round(PERIOD.reach * wide)
    around = np.ix_(np.arange(reach), np.arange(-reach, reach))
    likeness = (alike[around] / shared[around]).astype(np.float32)
    highest = likeness == cv2.dilate(likeness, np.ones((5, 5), np.uint8))
    far = np.hypot(*np.meshgrid(np.arange(reach), np.arange(-reach, reach), indexing="ij"))
    further = likeness[highest & (far >= PERIOD.nearest)]
    return float(further.max(initial=-1.0)) / max(float(likeness[0, reach]), 1e-12)
