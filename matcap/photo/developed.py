"""Converts developed pictures from code values to linear Rec.709, and downsamples them.

They are not radiometric: the camera's tone curve is unknown, and only the transfer function of the
colour space is inverted. lossy.py and lossless.py read the files.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import Linearise, largest_code
from matcap.files.stated_color import StatedColor
from matcap.photo.hdr_gain_map import HdrGainMap, applied
from matcap.photo.photo import Decoded
from matcap.photo.shrink import Rows, area_averaged, shrink, shrunk_size
from matcap.photo.tone import WITH_GAIN_MAP, Development


@dataclass(frozen=True)
class Coded:
    """A picture of code values."""

    rows: Callable[[int, int], NDArray[Any]]
    """Function of (first row, row after the last) to code values (n, W, 3); called once for each
    strip, from the top."""
    width: int
    height: int
    """Pixels of a row, and number of rows."""
    dtype: np.dtype[Any]
    """Type of the code values."""
    color: StatedColor = StatedColor()
    """Colour space of the file."""
    clip_at: float = 1.0
    """Share of the largest code value from which on pixels count as clipped; of floating-point
    numbers the value itself."""
    opacity: NDArray[Any] | None = None
    """(H, W) code values of alpha, or None."""
    size: tuple[int, int] | None = None
    """(width, height) of the file's picture, if the decoder has reduced it."""
    gain_map: HdrGainMap | None = None
    """HDR gain map on the grid of the picture, or None."""
    white: float = 1.0
    """Light of the file that counts as white."""
    notes: tuple[str, ...] = ()
    """Sentences for the report."""


def decode(coded: Coded, long_side: int | None, where: str, orientation: int) -> Decoded:
    """Convert to linear Rec.709, and downsample.

    Args:
        long_side: of the result, pixels, or None.
        orientation: EXIF's, passed on.

    Raises:
        MatcapError: a value is NaN or infinite.
    """
    linearise, notes = coded.color.lineariser(coded.dtype)
    whole = np.issubdtype(coded.dtype, np.integer)
    clip_code = coded.clip_at * largest_code(coded.dtype)
    clip_code = np.ceil(clip_code) if whole else clip_code
    gain_map, scale = coded.gain_map, np.float32(1.0 / coded.white)
    headroom = _headroom(coded, linearise)
    at_limit = 0

    def read(top: int, bottom: int) -> Rows:
        codes = coded.rows(top, bottom)
        if not whole and not np.isfinite(codes).all():
            raise MatcapError.at(
                where,
                "the picture has values that are NaN or infinite",
                "export it again without them",
            )
        light = linearise(codes)
        red, green, blue = (codes[..., channel] >= clip_code for channel in range(3))
        clipped: NDArray[np.bool_] = red | green | blue
        if gain_map is not None:
            light, at_most = gain_map.light(light, slice(top, bottom))
            clipped &= at_most
        elif scale != 1.0:
            light = light * scale
        nonlocal at_limit
        at_limit += int(np.count_nonzero(clipped))
        return light, clipped

    pixels, clipped = shrink(read, coded.width, coded.height, long_side)
    opacity, transparent = _opacity(coded, long_side)
    return Decoded(
        pixels,
        clipped,
        coded.size or (coded.width, coded.height),
        orientation,
        notes=coded.notes
        + notes
        + transparent
        + (() if gain_map is None else (applied(gain_map),)),
        clipped_share=at_limit / (coded.width * coded.height),
        linear=gain_map is None and _is_linear(linearise, coded.dtype),
        headroom=headroom,
        floating=not whole,
        development=Development() if gain_map is None else WITH_GAIN_MAP,
        opacity=opacity,
    )


def _headroom(coded: Coded, linearise: Linearise) -> float:
    """Light at which channels clip, in units of white: of PQ and HLG, and of floating point."""
    if coded.gain_map is not None:
        return coded.gain_map.headroom
    if math.isinf(coded.clip_at):
        return math.inf
    floating = not np.issubdtype(coded.dtype, np.integer)
    full = (coded.clip_at if floating else largest_code(coded.dtype)) * np.ones((1, 1, 3))
    brightest = float(linearise(full.astype(coded.dtype)).min()) / coded.white
    # Rounding of matrices and curves aside, codes end at white.
    return brightest if abs(brightest - 1.0) > 0.02 else 1.0


def _is_linear(linearise: Linearise, dtype: np.dtype[Any]) -> bool:
    """Whether codes are proportional to light: half of the largest is half of its light."""
    codes = np.array([0.5, 1.0])[:, None, None] * np.full((1, 1, 3), largest_code(dtype))
    half, whole = linearise(codes.astype(dtype)).mean(axis=(1, 2))
    return bool(abs(half / whole - 0.5) < 0.01)


def three_channels(codes: NDArray[Any]) -> NDArray[Any]:
    """(n, W, 3) of (n, W) or (n, W, C): grey is repeated, alpha dropped."""
    if codes.ndim == 2:
        codes = codes[..., None]
    if codes.shape[-1] < 3:
        return np.repeat(codes[..., :1], 3, axis=-1)
    return codes[..., :3]


def _opacity(
    coded: Coded, long_side: int | None
) -> tuple[NDArray[np.float32] | None, tuple[str, ...]]:
    """(h, w) share of a pixel's area with alpha above 0.5, or None; and notes.

    Constant alpha is ignored, with a note if it is below 1.
    """
    codes = coded.opacity
    if codes is None:
        return None, ()
    largest = largest_code(codes.dtype)
    if codes.min() == codes.max():
        says = "All of the picture is equally transparent: its transparency is ignored."
        return None, () if codes.flat[0] >= largest else (says,)
    shown = np.where(codes > 0.5 * largest, np.uint8(255), np.uint8(0))
    resized = area_averaged(shown, shrunk_size(coded.width, coded.height, long_side))
    return np.asarray(resized / np.float32(255.0), np.float32), ()
