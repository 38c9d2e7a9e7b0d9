"""Developed pictures: code values to linear light, shrunk.

None of them is radiometric: the camera's or a program's curve is in them, and only the colour
space's own curve is undone. `lossy` and `lossless` read the files.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import Linearise
from matcap.files.stated_color import StatedColor
from matcap.photo.decoded import Decoded
from matcap.photo.shrink import Rows, shrink, shrunk_size

_WHITE = 0.995  # light at which colours that are no red, green and blue count as clipped


@dataclass(frozen=True)
class Coded:
    """A picture as code values: rows (first, after the last) give (n, W, 3) of dtype.

    Attributes:
        rows: called once for each strip, from the top.
        width, height: of what rows give.
        dtype: of the codes.
        color: what the file says of red, green and blue.
        other: how to linearise codes that are none of these (inks, CIELAB), and what to say of it.
        clip_at: share of the largest code that counts as clipped.
        opacity: (H, W) codes of alpha, or None where all is opaque.
        size: (width, height) of the file's picture, where decoding has shrunk it.
        notes: sentences for the report.
    """

    rows: Callable[[int, int], NDArray[Any]]
    width: int
    height: int
    dtype: np.dtype[Any]
    color: StatedColor = StatedColor()
    other: tuple[Linearise, tuple[str, ...]] | None = None
    clip_at: float = 1.0
    opacity: NDArray[Any] | None = None
    size: tuple[int, int] | None = None
    notes: tuple[str, ...] = ()


def decode(coded: Coded, long_side: int | None, where: str, orientation: int) -> Decoded:
    """Linearise and shrink.

    Raises:
        MatcapError: a value is NaN or infinite.
    """
    linearise, notes = coded.other or coded.color.lineariser(coded.dtype)
    whole = np.issubdtype(coded.dtype, np.integer)
    clip_code = np.ceil(coded.clip_at * np.iinfo(coded.dtype).max) if whole else coded.clip_at
    at_limit = 0

    def read(top: int, bottom: int) -> Rows:
        codes = coded.rows(top, bottom)
        if not whole and not np.isfinite(codes).all():
            raise MatcapError(
                "the picture has values that are NaN or infinite",
                where=where,
                remedy="export it again without them",
            )
        light = linearise(codes)
        judged, limit = (codes, clip_code) if coded.other is None else (light, _WHITE)
        red, green, blue = (judged[..., channel] >= limit for channel in range(3))
        clipped: NDArray[np.bool_] = red | green | blue
        nonlocal at_limit
        at_limit += int(np.count_nonzero(clipped))
        return light, clipped

    pixels, clipped = shrink(read, coded.width, coded.height, long_side)
    return Decoded(
        pixels,
        clipped,
        coded.size or (coded.width, coded.height),
        orientation,
        notes=coded.notes + notes + _transparent_alike(coded),
        clipped_share=at_limit / (coded.width * coded.height),
        opacity=_opacity(coded, long_side),
    )


def three_channels(codes: NDArray[Any]) -> NDArray[Any]:
    """Grey repeated, alpha dropped: (n, W), (n, W, 1 to 4 or more) to (n, W, 3)."""
    if codes.ndim == 2:
        codes = codes[..., None]
    if codes.shape[-1] < 3:
        return np.repeat(codes[..., :1], 3, axis=-1)
    return codes[..., :3]


def _opacity(coded: Coded, long_side: int | None) -> NDArray[np.float32] | None:
    """(h, w) share of each pixel that is more opaque than not; None where there is no shape."""
    codes = coded.opacity
    if codes is None or codes.min() == codes.max():
        return None
    largest = np.iinfo(codes.dtype).max if np.issubdtype(codes.dtype, np.integer) else 1.0
    shown = np.where(codes > 0.5 * largest, np.uint8(255), np.uint8(0))
    size = shrunk_size(coded.width, coded.height, long_side)
    resized = cv2.resize(shown, size, interpolation=cv2.INTER_AREA)
    return np.asarray(resized / np.float32(255.0), np.float32)


def _transparent_alike(coded: Coded) -> tuple[str, ...]:
    """What is said of a picture that is transparent, but nowhere more than elsewhere."""
    codes = coded.opacity
    if codes is None or codes.min() != codes.max():
        return ()
    whole = np.iinfo(codes.dtype).max if np.issubdtype(codes.dtype, np.integer) else 1.0
    says = "The picture is transparent all over alike: its transparency is ignored."
    return () if codes.flat[0] >= whole else (says,)
