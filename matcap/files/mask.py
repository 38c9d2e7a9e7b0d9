"""Reads masks from images, as grey or as transparency."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.pixels import read_pixels
from matcap.files.rec709 import LUMINANCE

_STEP = 1.5 / 255.0  # code values that differ by less count as equal


def read_mask(path: Path) -> NDArray[np.float32]:
    """(H, W) mask in [0, 1] of an image.

    An opaque image's mask is its luma, in code values. A transparent image of a single colour, even
    black, or of colours, has its alpha as the mask; one of greys has luma times alpha.

    Raises:
        MatcapError: missing, not an image, wholly transparent, or floats outside [0, 1].
    """
    pixels = read_pixels(path)
    red, green, blue = (
        pixels.channel(role if role in pixels.roles else "R") for role in ("R", "G", "B")
    )
    grey = (
        red
        if pixels.grey
        else sum(
            np.float32(weight) * plane
            for weight, plane in zip(LUMINANCE, (red, green, blue), strict=True)
        )
    )
    grey = np.asarray(grey, np.float32)
    if not pixels.whole and not 0.0 <= float(grey.min()) <= float(grey.max()) <= 1.0:
        raise MatcapError.at(
            path,
            f"has values from {grey.min():.3g} to {grey.max():.3g}, not from 0 to 1",
            "save it as a PNG of 8 or 16 bits",
        )
    if "A" not in pixels.roles:
        return grey
    alpha = np.clip(pixels.channel("A"), 0.0, 1.0)
    seen = alpha > 0.0
    if not seen.any():
        raise MatcapError.at(path, "all of it is transparent", "save it without transparency")
    if float(alpha.min()) >= 1.0 - 1e-6:
        return grey
    spread = np.maximum(np.abs(red - green), np.abs(green - blue))[seen]
    if float(np.ptp(grey[seen])) < _STEP or float(spread.mean()) > _STEP:
        return alpha
    return grey * alpha
