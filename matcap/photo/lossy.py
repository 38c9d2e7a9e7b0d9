"""Reads JPEG, WebP, AVIF and HEIC, by Pillow and pillow-heif: 8 bits, HEIC up to 12.

Pillow reports truncated JPEG files. Its readers are called directly, because Image.open refuses
pictures of more than 178 megapixels, which phones take.
"""

from __future__ import annotations

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
from matcap.photo import hdr_gain_map
from matcap.photo.developed import Coded, decode, three_channels
from matcap.photo.exif import Exif, FocalPlane, read_exif
from matcap.photo.hdr_gain_map import HdrGainMap
from matcap.photo.photo import Decoded
from matcap.photo.refusals import check_size, decoding, missing_extra, unsupported

# Clip level, as lossy coding may decode 255 to 254.
_LOSSY_CLIP = 254.0 / 255.0
# Pixels beyond which a JPEG is decoded at half size (DCT scaling), if that suffices.
_LARGE = 100_000_000

_WIDEST_META = 1 << 16  # first bytes of a HEIC or AVIF in which its items are searched
_MODES = {"RGB", "RGBA", "RGBX", "L", "LA"}  # Pillow's modes that are read directly


def read_jpeg(path: Path, long_side: int | None) -> tuple[Decoded, Exif]:
    """Read a JPEG, the first of several pictures, with its HDR gain map.

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
    )
    if hdr_gain_map.has_mark(path):
        coded = _brightened(
            coded,
            lambda: hdr_gain_map.of_jpeg(
                path.read_bytes(), hdr_gain_map.exif_ifd(image.info.get("exif", b""))
            ),
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
    picture = _coded(pixels, stated_color(path), (*notes, *_unread_map(path)))
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
    """Read a HEIC through pillow-heif, an extra, with Apple's HDR gain map.

    Raises:
        MatcapError: pillow-heif is not installed, or the file is truncated, damaged or too small.
    """
    try:
        import pillow_heif
    except ImportError as error:
        raise missing_extra(path, "HEIC", "heic") from error

    with decoding(path, "HEIC"):
        image: Any = pillow_heif.open_heif(path, convert_hdr_to_8bit=False)
        check_size(path, *image.size)
        pixels = np.asarray(image)
        info = dict(image.info)
        maps = [np.asarray(image.get_aux_image(k)) for k in _apple_maps(info)[:1]]
    coded = _coded(pixels, stated_color(path), () if maps else _unread_map(path))
    if maps:
        coded = _brightened(coded, lambda: _apple_map(path, maps[0], info, image.size))
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


def _brightened(coded: Coded, find: Callable[[], HdrGainMap]) -> Coded:
    """A picture with its HDR gain map; one that cannot be used (ValueError) is noted."""
    try:
        gain_map = hdr_gain_map.matching(find(), coded.width, coded.height)
    except ValueError as error:
        return replace(coded, notes=(*coded.notes, hdr_gain_map.left_out(str(error))))
    return replace(coded, gain_map=gain_map)


def _apple_maps(info: dict[str, Any]) -> list[int]:
    """Numbers of a HEIC's auxiliary pictures that are gain maps."""
    return list(info.get("aux", {}).get(hdr_gain_map.APPLE, ()))


def _apple_map(
    path: Path, codes: NDArray[Any], info: dict[str, Any], size: tuple[int, int]
) -> HdrGainMap:
    """Apple's gain map of an auxiliary picture (h, w, ...), turned as the base is.

    Raises:
        ValueError: its headroom is missing, or it has more than 8 bits.
    """
    if codes.dtype != np.uint8:
        raise ValueError("it has more than 8 bits")
    # XMP of the auxiliary picture is stored as it is, and not handed out.
    headroom = hdr_gain_map.apple_headroom(
        hdr_gain_map.exif_ifd(info.get("exif") or b""), path.read_bytes()
    )
    gain_map = hdr_gain_map.apple(codes.reshape(*codes.shape[:2], -1), None, headroom)
    turned = replace(gain_map, codes=np.ascontiguousarray(np.rot90(gain_map.codes)))
    return gain_map if gain_map.fits(*size) or not turned.fits(*size) else turned


def _unread_map(path: Path) -> tuple[str, ...]:
    """Note on a HEIC's or AVIF's gain map that no decoder hands out."""
    with path.open("rb") as file:
        item = b"tmap" in file.read(_WIDEST_META)
    if not item and not hdr_gain_map.has_mark(path):
        return ()
    return (hdr_gain_map.left_out("its form in this kind of file is not supported"),)
