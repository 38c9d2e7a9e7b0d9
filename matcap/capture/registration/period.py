"""Test for periodic patterns, whose feature matches are ambiguous by whole periods.

Only aperiodic features (stains, flaws, a border) resolve the ambiguity; with too few of them the
matches are inconsistent.
"""

from __future__ import annotations

import cv2
import numpy as np

from matcap.capture.registration.keypoints import FINE
from matcap.photo.photo import Photo
from matcap.photo.shrink import area_averaged

# Settings of the test whether a match is shifted by a period of a repeating pattern.
_ACROSS = 640  # width of the downsampled photograph, pixels
_SLOW = 12.0  # larger standard deviation of the band-pass, pixels; the smaller is FINE
_NEAREST = 4  # least lag, pixels; at smaller ones any smooth texture correlates
_REACH = 0.2  # largest lag along each axis, as a share of the width
# Autocorrelation from which a pattern is periodic; leather, stone and plaster have below 0.07,
# most weaves 0.46 to 0.94 (docs/notes/several.md).
_ALIKE = 0.35


def repeats_itself(photo: Photo) -> bool:
    """Whether the photographed pattern is periodic: largest autocorrelation above `alike`."""
    return likeness_further(photo) > _ALIKE


def likeness_further(photo: Photo) -> float:
    """Largest local maximum of the texture's autocorrelation at lags of 4 pixels or more.

    In [-1, 1]; lags are up to 0.2 of the width along each axis.
    """
    rows, columns = photo.pixels.shape[:2]
    wide = min(columns, _ACROSS)
    size = (wide, round(wide * rows / columns))
    grey = area_averaged(photo.pixels.mean(2), size)
    log = np.log(np.maximum(grey, 1e-5)).astype(np.float32)
    texture = cv2.GaussianBlur(log, (0, 0), FINE) - cv2.GaussianBlur(log, (0, 0), _SLOW)
    texture -= texture.mean()
    fields = [texture, np.ones_like(texture)]
    whole = tuple(2 * side for side in texture.shape)
    alike, shared = (
        np.fft.irfft2(np.abs(np.fft.rfft2(each, whole)) ** 2, whole) for each in fields
    )
    reach = round(_REACH * wide)
    around = np.ix_(np.arange(reach), np.arange(-reach, reach))
    likeness = (alike[around] / shared[around]).astype(np.float32)
    highest = likeness == cv2.dilate(likeness, np.ones((5, 5), np.uint8))
    far = np.hypot(*np.meshgrid(np.arange(reach), np.arange(-reach, reach), indexing="ij"))
    further = likeness[highest & (far >= _NEAREST)]
    return float(further.max(initial=-1.0)) / max(float(likeness[0, reach]), 1e-12)
