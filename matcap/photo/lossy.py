"""Reads JPEG, WebP, AVIF and HEIC, by Pillow and pillow-heif: 8 bits, HEIC up to 12.

Pillow reports truncated JPEG files. Its readers are called directly, because Image.open refuses
pictures of more than 178 megapixels, which phones take.
"""

from __future__ import annotations

import mmap
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from matcap.files import bmff
from matcap.files.jpeg_coding import unsupported_jpeg
from matcap.files.stated_color import StatedColor, stated_color
from matcap.photo.developed import Coded, decode, three_channels
from matcap.photo.exif import Exif, FocalPlane, read_exif
from matcap.photo.photo import Decoded
from matcap.photo.refusals import check_size, decoding, missing_extra, unsupported

# Clip level, as lossy coding may decode 255 to 254.
_LOSSY_CLIP = 254.0 / 255.0
# Pixels beyond which a JPEG is decoded at half size (DCT scaling), if that suffices.
_LARGE = 100_000_000

# Signatures of HDR gain maps: Ultra HDR and Adobe, Apple, ISO 21496-1.
_HDR_MARKS = (b"ns.adobe.com/hdr-gain-map", b"aux:hdrgainmap", b"iso:ts:21496:-1")
_HDR_NOTE = "The file carries an HDR gain map, which was not applied."
_MODES = {"RGB", "RGBA", "RGBX", "L", "LA"}  # Pillow's modes that are read directly


def read_jpeg(path: Path, long_side: int | None) -> tuple[Decoded, Exif]:
    """Read a JPEG, the first of several pictures, without its gain map.

    Raises:
        MatcapError: truncated, damaged, too small, too large, of 12 bits, or CMYK.
    """
    from PIL.JpegImagePlugin import JpegImageFile

    if coding := unsupported_jpeg(path):
        raise unsupported(path, coding)
    with decoding(path, "JPEG"), warnings.catch_warnings(), path.open("rb") as file:
        warnings.simplefilter("ignore")  # about malformed tags
        image = JpegImageFile(file)
        size = image.size
        check_size(path, *size)
        if size[0] * size[1] > _LARGE and long_side is not None and 2 * long_side <= max(size):
            image.draft(image.mode, ((size[0] + 1) // 2, (size[1] + 1) // 2))
        image.load()
    if image.mode not in _MODES:
        raise unsupported(path, f"a JPEG of {image.mode} colours")

    def rows(top: int, bottom: int) -> NDArray[Any]:
        return three_channels(np.asarray(image.crop((0, top, image.width, bottom))))

    coded = Coded(
        rows,
        image.width,
        image.height,
        np.dtype(np.uint8),
        stated_color(path),
        _LOSSY_CLIP,
        size=size,
        notes=_hdr_notes(path),
    )
    exif = read_exif(path)
    return decode(coded, long_side, str(path), exif.orientation), exif


def read_webp_or_avif(path: Path, form: str, long_side: int | None) -> tuple[Decoded, Exif]:
    """Read a WebP or AVIF picture, the first of several.

    Raises:
        MatcapError: truncated, damaged, too small, too large, or Pillow without AVIF.
    """
    decoder = _pillow_decoder(form)
    if decoder is None:
        raise unsupported(path, f"{form} by the Pillow that is installed")
    with decoding(path, form), warnings.catch_warnings(), path.open("rb") as file:
        warnings.simplefilter("ignore")
        image: Any = decoder(file)
        check_size(path, *image.size)
        image.load()
        if image.mode not in _MODES:
            image = image.convert("RGB")
        pixels, info = np.asarray(image), dict(image.info)
    # Pillow converts an AVIF's rotation to Exif's orientation.
    exif = read_exif(path) if form == "WebP" else read_exif(info.get("exif") or b"")
    notes = (
        () if getattr(image, "n_frames", 1) == 1 else ("The first of several pictures is read.",)
    )
    properties = bmff.Properties() if form == "WebP" else _properties(path)
    if properties.bits > 8:
        notes = (*notes, f"The picture's {properties.bits} bits are read as 8.")
    picture = _coded(pixels, stated_color(path), (*notes, *_hdr_notes(path)))
    exif = with_camera_matrix(exif, properties, image.size)
    return decode(picture, long_side, str(path), exif.orientation), exif


def _pillow_decoder(form: str) -> Callable[[BinaryIO], Any] | None:
    """Pillow's reader of a format; None if this Pillow does not support it."""
    from PIL import features

    try:
        if form == "WebP":
            from PIL.WebPImagePlugin import WebPImageFile as Reader
        else:
            from PIL.AvifImagePlugin import AvifImageFile as Reader  # type: ignore[assignment]
    except ImportError:
        return None
    return Reader if features.check(form.lower()) else None


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
    coded = _coded(pixels, stated_color(path), _hdr_notes(path))
    if pixels.dtype == np.uint16:
        coded = replace(coded, rows=_filled(coded.rows, int(info.get("bit_depth") or 10)))
    # The container's own rotation has been applied; the Exif block repeats it.
    exif = replace(read_exif(info.get("exif") or b""), orientation=1)
    size = (coded.width, coded.height)
    return decode(coded, long_side, str(path), 1), with_camera_matrix(exif, _properties(path), size)


def with_camera_matrix(exif: Exif, properties: bmff.Properties, size: tuple[int, int]) -> Exif:
    """Exif with the focal length of a file's camera matrix, if any; `size` is as decoded."""
    if properties.focal_length is None:
        return exif
    pixels = properties.focal_length * size[1 if properties.sideways else 0]
    return replace(exif, focal_plane=FocalPlane(pixels, max(size)), measured=True)


def _properties(path: Path) -> bmff.Properties:
    """Properties of the container; defaults if its boxes are damaged."""
    try:
        return bmff.primary_properties(path)
    except Exception:  # struct.error, KeyError, IndexError and others on damaged boxes
        return bmff.Properties()


def _coded(pixels: NDArray[Any], color: StatedColor, notes: tuple[str, ...]) -> Coded:
    """Wrap decoded code values (H, W) or (H, W, 1 to 4); 2 and 4 channels include alpha."""
    alpha = pixels.ndim == 3 and pixels.shape[2] in (2, 4)
    return Coded(
        lambda top, bottom: three_channels(pixels[top:bottom]),
        pixels.shape[1],
        pixels.shape[0],
        pixels.dtype,
        color,
        clip_at=_LOSSY_CLIP,
        opacity=np.ascontiguousarray(pixels[..., -1]) if alpha else None,
        notes=notes,
    )


def _filled(
    rows: Callable[[int, int], NDArray[Any]], bits: int
) -> Callable[[int, int], NDArray[Any]]:
    """Extend 10 or 12 bits in the upper bits of 16 to the full range, by repeating the bits."""

    def filled(top: int, bottom: int) -> NDArray[Any]:
        codes = rows(top, bottom)
        return np.asarray(codes | codes >> bits)

    return filled


def _hdr_notes(path: Path) -> tuple[str, ...]:
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return (_HDR_NOTE,) if any(data.find(mark) >= 0 for mark in _HDR_MARKS) else ()
