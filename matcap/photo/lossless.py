"""Reads PNG and TIFF of 8 and 16 bits, and TIFF in floating point, by OpenImageIO.

Of a TIFF with several pages the largest picture is read, not thumbnails or masks. CMYK and CIELAB
are refused, as OpenImageIO's conversion is not colorimetric.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import LINEAR, ColorSpace
from matcap.files.exr import forget_error
from matcap.files.stated_color import StatedColor, stated_color
from matcap.photo.developed import Coded, decode, three_channels
from matcap.photo.exif import Exif, read_exif
from matcap.photo.floating import light
from matcap.photo.photo import Decoded
from matcap.photo.refusals import check_size, decoding, unreadable, unsupported

# TIFF 6.0, and the supplements 1 and 2: PhotometricInterpretation.
_GREYS, _MASK = (0, 1), 4
_NO_RGB = {5: "inks (CMYK)", 8: "CIELAB colours", 9: "ICCLAB colours"}
_REDUCED, _IS_MASK = 1, 4  # bits of NewSubfileType
_MOST_PAGES = 64  # read at most; a damaged file may claim any number
_FORMATS, _FLOATING = (1, 2, 3, 4), 3  # SampleFormat: unsigned, signed, floating, undefined
_JPEGS = (6, 7)  # compressions
# Compressions that every OpenImageIO decodes; a failure with others means unsupported.
_USUAL = {1, 2, 3, 4, 5, 6, 7, 8, 32771, 32773, 32946}


@dataclass(frozen=True)
class _Page:
    """The page of a file that is read."""

    index: int = 0
    """Index of the page."""
    compression: tuple[str, bool] = ("", True)
    """Name of the compression, and whether it is in _USUAL."""
    orientation: int | None = None
    """EXIF's, of a page other than the first; None is the file's."""
    notes: tuple[str, ...] = ()
    """Notes on other pages."""


def read_png_or_tiff(
    path: Path, form: str, long_side: int | None, white: float | None = None
) -> tuple[Decoded, Exif]:
    """Read a PNG or TIFF of 8 or 16 bits, or a TIFF in floating point (floating.py).

    Args:
        form: "PNG" or "TIFF".
        long_side: of the result, pixels, or None.
        white: value of white in floating point, by default 1.

    Raises:
        MatcapError: truncated, damaged, too small, too large, not supported, or with NaN or
            infinite values.
    """
    import OpenImageIO as oiio

    page = _page_of(path) if form == "TIFF" else _Page()
    with decoding(path, form):
        config = oiio.ImageSpec()
        config.attribute("oiio:UnassociatedAlpha", 1)  # colours not multiplied by alpha
        source = oiio.ImageInput.open(str(path), config)
        if source is None:
            forget_error(oiio.geterror)  # or it is printed at exit
            raise _broken(path, form, page)
        if page.index and not source.seek_subimage(page.index, 0):
            forget_error(source.geterror)
            raise _broken(path, form, page)
        spec = source.spec()
    check_size(path, spec.width, spec.height)
    alpha = spec.alpha_channel
    stored = _stored_type(spec.format)
    dtype = np.dtype("float32" if stored == "float" else stored)
    in_strips = alpha < 0 and dtype.kind == "u" and not spec.tile_width
    rows = _read_rows(source, spec, stored, lambda: _broken(path, form, page))
    notes, opacity = page.notes, None
    if not in_strips:
        whole = rows(0, spec.height)
        if alpha >= 0:
            opacity = np.ascontiguousarray(whole[..., alpha])

        def rows(top: int, bottom: int) -> NDArray[Any]:
            return whole[top:bottom]

    exif = read_exif(path)
    if dtype.kind == "f":
        colours = three_channels(rows(0, spec.height))
        color = _color(path, page.index, dtype)
        coded = light(path, colours, white, notes, color, opacity)
        return decode(coded, long_side, str(path), page.orientation or exif.orientation), exif
    coded = Coded(
        lambda top, bottom: three_channels(rows(top, bottom)),
        spec.width,
        spec.height,
        dtype,
        _color(path, page.index, dtype),
        opacity=opacity,
        notes=notes,
    )
    return decode(coded, long_side, str(path), page.orientation or exif.orientation), exif


def _read_rows(
    source: Any,  # noqa: ANN401
    spec: Any,  # noqa: ANN401
    stored: str,
    broken: Callable[[], MatcapError],
) -> Callable[[int, int], NDArray[Any]]:
    """A function that reads rows (n, W, C) of an open picture, in order from the top."""
    import OpenImageIO as oiio

    def rows(top: int, bottom: int) -> NDArray[Any]:
        try:
            if (top, bottom) == (0, spec.height):
                codes = source.read_image(source.current_subimage(), 0, 0, spec.nchannels, stored)
            else:
                y = spec.y
                codes = source.read_scanlines(
                    y + top, y + bottom, 0, 0, spec.nchannels, oiio.TypeDesc(stored)
                )
            said = source.has_error
            forget_error(source.geterror)
            if bottom == spec.height:
                source.close()
        except Exception as error:
            raise broken() from error
        if codes is None or said:
            raise broken()
        return np.asarray(codes)

    return rows


def _page_of(path: Path) -> _Page:
    """The largest page that is neither a thumbnail nor a mask, the first of equals."""
    import tifffile

    with decoding(path, "TIFF"), tifffile.TiffFile(path) as file:
        pages: list[Any] = list(islice(file.pages, _MOST_PAGES))
        sizes = [page.imagewidth * page.imagelength for page in pages]
        whole = [
            index
            for index, page in enumerate(pages)
            if not int(page.subfiletype) & (_REDUCED | _IS_MASK) and int(page.photometric) != _MASK
        ]
        chosen = max(whole or range(len(pages)), key=lambda index: (sizes[index], -index))
        page = pages[chosen]
        inside = [sub for each in pages for sub in islice(each.pages or (), _MOST_PAGES)]
        larger = [sub for sub in inside if sub.imagewidth * sub.imagelength > sizes[chosen]]
        photometric, code = int(page.photometric), int(page.compression)
        samples = int(page.samplesperpixel)
        name = str(getattr(page.compression, "name", code)).upper()
        bits, form = int(page.bitspersample), int(page.sampleformat)
        equal = sum(sizes[index] == sizes[chosen] for index in whole)
        known = _Page(
            chosen,
            (name, code in _USUAL and not (code in _JPEGS and bits != 8)),
            _orientation(page) if chosen else None,
            (f"The file holds {equal} pictures: the first is read.",) if equal > 1 else (),
        )
    if form not in _FORMATS or (form == _FLOATING and bits not in (16, 32, 64)):
        raise unsupported(path, f"a TIFF of {bits} bits in sample format {form}")
    if larger:
        raise unsupported(path, "a TIFF whose picture is in a sub-directory behind a smaller one")
    if photometric in _GREYS and samples > 2:  # two are grey and its alpha
        raise unsupported(path, f"a TIFF of {samples} bands that are not named red, green and blue")
    if photometric in _NO_RGB:
        raise unsupported(path, f"a TIFF of {_NO_RGB[photometric]}")
    return known


def _broken(path: Path, form: str, page: _Page) -> MatcapError:
    name, usual = page.compression
    return unreadable(path, form) if usual else unsupported(path, f"TIFF compression {name}")


def _orientation(page: Any) -> int | None:  # noqa: ANN401
    tag = page.tags.get(274)
    return int(tag.value) if tag is not None and tag.value in range(1, 9) else None


def _color(path: Path, page: int, dtype: np.dtype[Any]) -> StatedColor:
    color = stated_color(path, page)
    if dtype.kind != "f":
        return color
    # Floating point is linear, in the stated primaries, unless there is a profile.
    space = ColorSpace(LINEAR.name, LINEAR.curves, color.space.matrix)
    return StatedColor(color.profile, space, color.notes)


def _stored_type(form: Any) -> str:  # noqa: ANN401
    """The type to read a format as: uint8, uint16 or float."""
    name = str(form)
    if name in ("half", "float", "double"):
        return "float"
    return "uint8" if name in ("uint8", "int8") else "uint16"
