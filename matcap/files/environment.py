"""Read environment maps: latitude-longitude EXR or Radiance HDR.

The result is linear Rec.709 radiance, converted from the primaries that the file states. Pixels
outside of an EXR file's data window are black. Code values (PNG, JPEG) are decoded, with a note.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.names import note
from matcap.files.pixels import linear_colours, read_pixels
from matcap.files.settings import BRIGHTEST

_REMEDY = "give a latitude-longitude EXR or HDR picture"
_CUBE = "CubeFace Environment"
_SHAPE = 0.05  # largest relative deviation of the sides from 2 : 1
_DARK = 0.5  # largest sum of negative values over that of positive ones
_SMALLEST = 4  # pixels: smaller pictures may have any shape
_WIDEST = 2048  # wider maps are downsampled for use; a texel is then 0.18 degrees

EnvironmentPicture = NDArray[np.float32]


def read_picture(path: Path) -> EnvironmentPicture:
    """Read (H, W, 3) linear radiance: top row +y, middle column +z, right half towards -x.

    Raises:
        MatcapError: missing, unreadable, of another projection, not finite, mostly negative, or too
            bright.
    """
    where = str(path)
    if not path.is_file():
        raise MatcapError.at(where, "no such file", "check the path")
    pixels = read_pixels(path, outside=0.0)
    if pixels.surroundings == _CUBE:
        raise MatcapError.at(where, "is a cube map, of six faces", _REMEDY)
    picture, notes = linear_colours(pixels)
    for sentence in (*pixels.notes, *notes):
        note(f"{where}: {sentence}")
    if pixels.whole:
        note(f"{where}: code values, not light: decoded, and nothing is brighter than white (1.0)")
    if pixels.partial:
        note(f"{where}: the file holds a part of its picture (its data window); the rest is black")
    picture = _radiance(np.asarray(picture, np.float32), where)
    height, width = picture.shape[:2]
    if max(width, height) > _SMALLEST and abs(width / (2.0 * height) - 1.0) > _SHAPE:
        raise MatcapError.at(
            where,
            f"is {width} x {height} pixels, and such a picture is twice as wide as high",
            _REMEDY,
        )
    return picture


def narrowed(picture: EnvironmentPicture) -> EnvironmentPicture:
    """The picture, downsampled if it is wider than programs need."""
    height, width = picture.shape[:2]
    if width <= _WIDEST:
        return picture
    size = (_WIDEST, max(2, round(height * _WIDEST / width)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


def _radiance(picture: EnvironmentPicture, where: str) -> EnvironmentPicture:
    """Radiance clamped to 0, with a note; small negative values are rounding or out of gamut.

    Raises:
        MatcapError: values above BRIGHTEST, or negative ones that add up to half of the light.
    """
    if picture.max() > BRIGHTEST:
        raise MatcapError.at(
            where,
            f"has a value of {picture.max():.2g}, too bright for single precision",
            "clip its brightest pixels in a picture editor",
        )
    below = picture < 0.0
    if not below.any():
        return picture
    dark, light = (float(np.abs(picture[part]).sum(dtype=np.float64)) for part in (below, ~below))
    if dark > _DARK * light:
        raise MatcapError.at(where, "is mostly negative, which no radiance is", _REMEDY)
    pixels = int(below.any(axis=2).sum())
    note(f"{where}: {pixels} pixels are negative, down to {picture.min():.3g}, and set to 0")
    return np.maximum(picture, np.float32(0.0))
