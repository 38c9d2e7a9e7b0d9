"""Developed pictures: JPEG, HEIC, WebP and AVIF, from code values to linear Rec.709."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files import containers
from matcap.files.color import Linearise, largest_code
from matcap.files.containers import loaded_jpeg, unsupported_jpeg
from matcap.files.stated_color import StatedColor, stated_color
from matcap.photo import hdr_gain_map
from matcap.photo.exif import Exif, FocalPlane, read_exif
from matcap.photo.hdr_gain_map import HdrGainMap, applied
from matcap.photo.left_out import Rows, area_averaged, shrink, shrunk_size
from matcap.photo.photo import (
    WITH_GAIN_MAP,
    Decoded,
    Development,
    check_size,
    decoding,
    missing_extra,
    unsupported,
)

# Converts developed pictures from code values to linear Rec.709, and downsamples them.
#
# They are not radiometric: the camera's tone curve is unknown, and only the transfer function of
# the colour space is inverted. developed.py and lossless.py read the files.


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
        if not whole and not np.abs(codes).max(initial=0.0) < _LARGEST:
            raise MatcapError.at(
                where,
                "the picture has values that are NaN or infinite, or above 1e30",
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


# Reads JPEG, WebP, AVIF and HEIC, by Pillow and pillow-heif: 8 bits, HEIC up to 12.
#
# Pillow reports truncated JPEG files. Its readers are called directly, because Image.open refuses
# pictures of more than 178 megapixels, which phones take.


# Clip level, as lossy coding may decode 255 to 254.
_LOSSY_CLIP = 254.0 / 255.0
# Pixels beyond which a JPEG is decoded at half size (DCT scaling), if that suffices.
_LARGE = 100_000_000

_LARGEST = 1e30  # values that matrices and means keep finite
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
        image, notes = loaded_jpeg(image, path)
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
        notes=notes,
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
    properties = containers.Properties() if form == "WebP" else _properties(path)
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


def with_camera_matrix(
    exif: Exif, properties: containers.Properties, size: tuple[int, int]
) -> Exif:
    """Exif with the focal length of a file's camera matrix, if any; `size` is as decoded."""
    if properties.focal_length is None:
        return exif
    pixels = properties.focal_length * size[1 if properties.sideways else 0]
    return replace(exif, focal_plane=FocalPlane(pixels, max(size)), measured=True)


def _properties(path: Path) -> containers.Properties:
    """Properties of the container; defaults if its boxes are damaged."""
    try:
        return containers.primary_properties(path)
    except Exception:  # struct.error, KeyError, IndexError and others on damaged boxes
        return containers.Properties()


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
