"""Reads and writes OpenEXR files: single-part scanlines, ZIP, Rec.709.

Written with OpenEXR, which stores no date, so that equal arrays give equal files. Read with
OpenImageIO, which returns errors, where OpenEXR prints them. Tiled files: synth/pictures.py.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.rec709 import REC709

LARGEST_HALF = 65504.0  # of half float (IEEE 754)


def write_exr(path: Path, pixels: NDArray[np.float32], *, half: bool) -> None:
    """Write (H, W, 3) as channels R, G, B or (H, W) as channel Y, as half floats or float32.

    Not atomic: write into an Output's stage.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
        OSError: the file cannot be written.
    """
    channels = {"RGB" if pixels.ndim == 3 else "Y": pixels}
    _write(path, channels, {"chromaticities": REC709}, half=half)


def write_exr_channels(path: Path, channels: Mapping[str, NDArray[np.float32]]) -> None:
    """Write planes (H, W) by channel name, as half floats.

    Not atomic: write into a staged folder.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
        OSError: the file cannot be written.
    """
    _write(path, channels, {}, half=True)


def check_representable(name: str, pixels: NDArray[np.float32], *, half: bool) -> None:
    """Raise MatcapError for values that the file cannot represent."""
    if not np.isfinite(pixels).all():
        raise MatcapError.at(name, "has values that are not finite", "make the maps again")
    if half and np.abs(pixels).max(initial=0.0) > LARGEST_HALF:
        raise MatcapError.at(name, "has values too large for half float (65504)", "scale them down")


def _write(
    path: Path, channels: Mapping[str, NDArray[np.float32]], more: Mapping[str, Any], *, half: bool
) -> None:
    """Write channels by name, with `more` entries of the header."""
    import OpenEXR

    stored = {}
    for name, pixels in channels.items():
        check_representable(path.name, pixels, half=half)
        stored[name] = np.ascontiguousarray(pixels, dtype=np.float16 if half else np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **more}
    try:
        OpenEXR.File(header, stored).write(str(path))
    except RuntimeError as error:
        # OpenEXR reports the cause in the text only.
        full = "No space left" in str(error)
        raise OSError(errno.ENOSPC if full else errno.EIO, str(error)) from error


@dataclass(frozen=True)
class NamedChannels:
    """Content of an EXR file."""

    pixels: NDArray[np.float32]
    """(H, W, C) values of the channels."""
    names: tuple[str, ...]
    """Names of the channels."""
    primaries: tuple[float, ...] | None
    """Chromaticities x, y of red, green, blue and white, or None."""


def read_exr(
    path: Path, *, size: tuple[int, int] | None = None, channels: Sequence[str] | None = None
) -> NamedChannels:
    """Read an EXR file.

    Args:
        size: expected (width, height); checked before any pixel is read.
        channels: names to read, in this order; None is all, in the file's order.

    Raises:
        MatcapError: missing, not an EXR file, truncated, corrupt, of another size, without a
            channel, or with values that are not finite.
    """
    import OpenImageIO as oiio

    remedy = "write the map set again"
    if not os.path.isfile(path):  # also False for invalid names
        raise MatcapError.at(path, "the file is missing", remedy)
    source = oiio.ImageInput.open(str(path))
    if source is None:
        forget_error(oiio.geterror)
        raise MatcapError.at(path, "this is not a readable EXR file", remedy)
    try:
        spec = source.spec()
        refuse_deep(path, spec)
        actual = (spec.width, spec.height)
        if size is not None and actual != size:
            raise MatcapError.at(
                path, f"is {actual[0]} x {actual[1]} texels, not {size[0]} x {size[1]}", remedy
            )
        missing = [name for name in channels or () if name not in spec.channelnames]
        if missing:
            raise MatcapError.at(path, f"has no channel {', '.join(missing)}", remedy)
        pixels = source.read_image("float")
        forget_error(source.geterror)
    except MemoryError as error:
        raise MatcapError.at(
            path, "there is not enough memory to read it", "free some memory, or write smaller maps"
        ) from error
    finally:
        source.close()
    if pixels is None:
        raise MatcapError.at(path, "the file is truncated or corrupt", remedy)
    if not np.isfinite(pixels).all():
        raise MatcapError.at(path, "has values that are not finite", remedy)
    names = tuple(channels or spec.channelnames)
    pixels = pixels[..., [spec.channelnames.index(name) for name in names]]
    return NamedChannels(np.asarray(pixels, dtype=np.float32), names, stated_primaries(spec))


def refuse_deep(path: Path, spec: Any) -> None:  # noqa: ANN401
    """Raise MatcapError for a deep EXR file, by OpenImageIO's specification of it."""
    if spec.deep:
        raise MatcapError.at(
            path,
            "this is a deep EXR file, which is not supported",
            "flatten it, and save it with one sample a pixel",
        )


def stated_primaries(spec: Any) -> tuple[float, ...] | None:  # noqa: ANN401
    """Chromaticities x, y of red, green, blue and white that an EXR file states, or None."""
    stated = spec.getattribute("chromaticities")
    return None if stated is None else tuple(float(value) for value in stated)


def forget_error(fetch: Callable[[], object]) -> str:
    """Fetch OpenImageIO's pending error, which it would otherwise print at exit; "" if none."""
    with suppress(UnicodeDecodeError):
        return str(fetch())
    return "an error that is no text"  # it may quote the file's bytes
