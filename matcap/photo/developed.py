"""Developed pictures: JPEG and HEIC (lossy, 8 bits), PNG and TIFF (8, 16 bits, floating point).

None of them is radiometric: the camera's or a program's curve is in them, and only the colour
space's own curve is undone. Pillow decodes JPEG because it reports a truncated file, OpenImageIO
the rest because it keeps 16 bits.
"""

from __future__ import annotations

import mmap
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import LINEAR, ColorSpace
from matcap.files.stated_color import StatedColor, stated_color
from matcap.photo.decoded import Decoded
from matcap.photo.exif import Exif, read_exif
from matcap.photo.refusals import check_size, decoding, missing_extra, unreadable
from matcap.photo.shrink import Rows, shrink

# Lossy coding rings: what was at 255 comes back at 254 as well.
_LOSSY_CLIP = 254.0 / 255.0

# What marks a picture that carries a second one to brighten it on HDR screens: Ultra HDR and
# Adobe, Apple, ISO 21496-1.
_HDR_MARKS = (b"ns.adobe.com/hdr-gain-map", b"aux:hdrgainmap", b"iso:ts:21496:-1")
_HDR_NOTE = "The file carries an HDR gain map, which was not applied."


@dataclass(frozen=True)
class Coded:
    """A picture as code values: rows (first, after the last) give (n, W, 3) of dtype."""

    rows: Callable[[int, int], NDArray[Any]]
    width: int
    height: int
    dtype: np.dtype[Any]
    color: StatedColor = StatedColor()
    clip_at: float = 1.0
    notes: tuple[str, ...] = ()


def read_jpeg(path: Path, long_side: int | None) -> tuple[Decoded, Exif]:
    """Read a JPEG; one with a gain map or several pictures gives the first, as it looks.

    Raises:
        MatcapError: truncated, damaged, too small, too large, or CMYK.
    """
    from PIL import Image

    with decoding(path, "JPEG"), warnings.catch_warnings(), path.open("rb") as file:
        warnings.simplefilter("ignore")  # large, and harmlessly malformed tags: judged below
        try:
            image = Image.open(file, formats=("JPEG", "MPO"))
        except Image.DecompressionBombError as error:
            raise MatcapError(
                "the picture is larger than can be read", where=str(path), remedy="reduce it"
            ) from error
        check_size(path, *image.size)
        image.load()
    if image.mode not in ("RGB", "L"):
        raise MatcapError(
            f"the picture's colours are {image.mode}", where=str(path), remedy="export it as RGB"
        )

    def rows(top: int, bottom: int) -> NDArray[Any]:
        return _three_channels(np.asarray(image.crop((0, top, image.width, bottom))))

    coded = Coded(
        rows,
        image.width,
        image.height,
        np.dtype(np.uint8),
        color=stated_color(path),
        clip_at=_LOSSY_CLIP,
        notes=_hdr_notes(path),
    )
    exif = read_exif(path)
    return decode(coded, long_side, str(path), exif.orientation), exif


def read_heic(path: Path, long_side: int | None) -> tuple[Decoded, Exif]:
    """Read a HEIC through pillow-heif, an extra.

    Raises:
        MatcapError: pillow-heif is not installed, or the file is truncated, damaged or too small.
    """
    try:
        import pillow_heif
    except ImportError as error:
        raise missing_extra(path, "HEIC", "heic") from error

    with decoding(path, "HEIC"):
        image = pillow_heif.open_heif(path, convert_hdr_to_8bit=False)
        check_size(path, *image.size)
        pixels = np.asarray(image)
        info = dict(image.info)
    coded = Coded(
        lambda top, bottom: _three_channels(pixels[top:bottom]),
        pixels.shape[1],
        pixels.shape[0],
        pixels.dtype,
        color=stated_color(path),
        clip_at=_LOSSY_CLIP,
        notes=_hdr_notes(path),
    )
    # The container's own rotation has been applied; the Exif block repeats it.
    return decode(coded, long_side, str(path), 1), read_exif(info.get("exif") or b"")


def read_png_or_tiff(path: Path, form: str, long_side: int | None) -> tuple[Decoded, Exif]:
    """Read a PNG or TIFF of 8 or 16 bits, or a TIFF in floating point (taken as linear light).

    Raises:
        MatcapError: truncated, damaged, too small, too large; NaN or infinite values.
    """
    import OpenImageIO as oiio

    with decoding(path, form):
        config = oiio.ImageSpec()
        config.attribute("oiio:UnassociatedAlpha", 1)  # colours are not to be darkened by alpha
        source = oiio.ImageInput.open(str(path), config)
        if source is None:
            oiio.geterror()  # or it is printed at exit
            raise unreadable(path, form)
        spec = source.spec()
        check_size(path, spec.width, spec.height)
        stored = _stored_type(spec.format)
        pixels = source.read_image(0, 0, 0, spec.nchannels, stored)
        broken = source.geterror()
        source.close()
    if pixels is None or broken:
        raise unreadable(path, form)
    floating = bool(np.issubdtype(pixels.dtype, np.floating))
    color = stated_color(path)
    if floating and color.profile is None:
        color = StatedColor(space=ColorSpace(LINEAR.name, LINEAR.curves, color.space.matrix))
    pixels, notes = _below_one(pixels) if floating else (pixels, ())
    coded = Coded(
        lambda top, bottom: _three_channels(pixels[top:bottom]),
        spec.width,
        spec.height,
        pixels.dtype,
        color=color,
        notes=notes,
    )
    exif = read_exif(path)
    return decode(coded, long_side, str(path), exif.orientation), exif


def decode(coded: Coded, long_side: int | None, where: str, orientation: int) -> Decoded:
    """Linearise and shrink.

    Raises:
        MatcapError: a value is NaN or infinite.
    """
    linearise, notes = coded.color.lineariser(coded.dtype)
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
        red, green, blue = (codes[..., channel] >= clip_code for channel in range(3))
        clipped: NDArray[np.bool_] = red | green | blue
        nonlocal at_limit
        at_limit += int(np.count_nonzero(clipped))
        return linearise(codes), clipped

    pixels, clipped = shrink(read, coded.width, coded.height, long_side)
    size = (coded.width, coded.height)
    return Decoded(
        pixels,
        clipped,
        size,
        orientation,
        notes=coded.notes + notes,
        clipped_share=at_limit / (coded.width * coded.height),
    )


def _three_channels(codes: NDArray[Any]) -> NDArray[Any]:
    """Grey repeated, alpha dropped: (n, W), (n, W, 1 to 4 or more) to (n, W, 3)."""
    if codes.ndim == 2:
        codes = codes[..., None]
    if codes.shape[-1] < 3:
        return np.repeat(codes[..., :1], 3, axis=-1)
    return codes[..., :3]


def _stored_type(form: Any) -> str:  # noqa: ANN401
    """The type to read OpenImageIO's format as: whole numbers of 8 or 16 bits, or float."""
    name = str(form)
    if name in ("half", "float", "double"):
        return "float"
    return "uint8" if name in ("uint8", "int8") else "uint16"


def _below_one(pixels: NDArray[np.float32]) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Scale numbers without a stated maximum so that the largest is 1, the clip level."""
    largest = float(pixels.max())
    if not (np.isfinite(largest) and largest > 1.0):
        return pixels, ()
    return pixels / np.float32(largest), (f"Values reach {largest:.4g}: scaled to reach 1.",)


def _hdr_notes(path: Path) -> tuple[str, ...]:
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return (_HDR_NOTE,) if any(data.find(mark) >= 0 for mark in _HDR_MARKS) else ()
