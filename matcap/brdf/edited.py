"""Maps that another program saved: with alpha, grey as three channels, or other primaries."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.exr import NamedChannels
from matcap.files.note import note
from matcap.files.rec709 import rec709_from

COLOURS = ("diffuse", "specular")  # maps whose three channels are a colour
_GREY = 2.0**-9  # largest difference of grey channels over the largest value: half-float rounding
_ALPHA = "A"

MapPixels = NDArray[np.float32]


def as_saved(stored: NamedChannels, channels: int, where: str) -> MapPixels:
    """(H, W, channels) of a map whose file has another number of channels.

    Drops alpha, with a note where it is not opaque; repeats one channel to three; reduces three
    equal ones to one. Anything else is returned as stored, for the caller to refuse.
    """
    pixels = without_alpha(stored)
    if pixels.shape[2] != stored.pixels.shape[2]:
        least = float(stored.pixels[..., stored.names.index(_ALPHA)].min())
        if least < 0.999:
            note(f"{where}: its transparency is not used")
    if pixels.shape[2] == 1 and channels == 3:
        return np.repeat(pixels, 3, axis=2)
    if pixels.shape[2] == 3 and channels == 1:
        spread = float(np.ptp(pixels, axis=2).max())
        if spread <= _GREY * float(np.abs(pixels).max()):
            return pixels[..., :1]
    return pixels


def without_alpha(stored: NamedChannels) -> MapPixels:
    """(H, W, C) without the alpha channel."""
    kept = [place for place, name in enumerate(stored.names) if name != _ALPHA]
    if not kept or len(kept) == len(stored.names):
        return stored.pixels
    return np.ascontiguousarray(stored.pixels[..., kept])


def in_rec709(colours: MapPixels, primaries: tuple[float, ...] | None, where: str) -> MapPixels:
    """(H, W, 3) linear colours, converted from the primaries that the file states.

    Raises:
        MatcapError: the primaries are degenerate.
    """
    try:
        matrix = None if primaries is None else rec709_from(primaries)
    except ValueError as error:
        raise MatcapError.at(
            where, f"its chromaticities span no colour space ({error})", "save it in Rec.709"
        ) from error
    if matrix is None:
        return colours
    note(f"{where}: colours converted from the file's primaries to Rec.709")
    return np.maximum(colours @ matrix.T.astype(np.float32), np.float32(0.0))
