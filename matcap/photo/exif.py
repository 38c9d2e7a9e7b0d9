"""Metadata of a photograph: orientation, field of view, flash, exposure (Exif 2.32, XMP)."""

from __future__ import annotations

import io
import re
import zlib
from dataclasses import dataclass
from math import atan, degrees, hypot, radians, tan
from pathlib import Path
from typing import Any, BinaryIO

from matcap.files.containers import FileKind, Tag, kind_of, pillow_info
from matcap.files.process import quiet_decoders
from matcap.files.stated_color import png_chunks

# | container | source |
# | --- | --- |
# | JPEG, TIFF, RAW | Exif; XMP if Exif has no orientation or focal length |
# | PNG | eXIf, XMP |
# | WebP | EXIF and XMP |
# | HEIC, AVIF | Exif from the decoder |

# mm, diagonal of the 36 x 24 mm frame, which FocalLengthIn35mmFilm refers to (CIPA DCG-001).
_FILM_DIAGONAL = hypot(36.0, 24.0)
_PHONE_REACH = tan(radians(33.0))  # half the long side over the distance
_LARGEST_XMP = 1 << 22  # bytes of XMP that are parsed
# Millimetres by FocalPlaneResolutionUnit (Exif 2.32); some cameras use 4 and 5.
_UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
# Ratio of tangents by focal plane resolution and by FocalLengthIn35mmFilm from which on the first
# is distrusted.
_CONTRADICTS = 1.5
_DIFFERS = 1.06  # ratio from which on there is a note; 20 mm is rounded by 2.5 %
_NARROWEST, _WIDEST = 2.0, 150.0  # plausible fields of view, degrees
_LARGEST_INFLATED = 1 << 24  # most bytes of a decompressed text


@dataclass(frozen=True)
class FocalPlane:
    """Focal length in pixels."""

    pixels: float
    """Focal length in pixels."""
    long_side: int | None = None
    """Long side of the picture that these pixels are of; None is the file's."""

    def fov(self, long_side: int) -> float:
        """Field of view in degrees across the long side, `long_side` pixels in the file."""
        return degrees(2.0 * atan((self.long_side or long_side) / 2.0 / self.pixels))


@dataclass(frozen=True)
class Exif:
    """Metadata that matcap uses."""

    orientation: int = 1
    """EXIF orientation, 1 to 8; 1 is upright."""
    film_focal_length: float | None = None
    """FocalLengthIn35mmFilm, mm, or None."""
    focal_plane: FocalPlane | None = None
    """Stated by FocalLength and FocalPlaneXResolution, or None."""
    flash_fired: bool | None = None
    """Whether the flash fired; None if unknown."""
    exposure: float | None = None
    """Exposure time times sensitivity over the squared f-number, or None; proportional to stored
    values for the same radiance."""
    camera: str = ""
    """Maker, model, lens, focal length and digital zoom; "" without a model."""

    def view(self, width: int, height: int) -> tuple[float | None, tuple[str, ...]]:
        """Field of view across the long side in degrees, or None; and notes to the user.

        Args:
            width, height: of the file's picture, pixels.
        """
        film = None
        if self.film_focal_length is not None:
            film = fov_of_film(self.film_focal_length, width, height)
        if self.focal_plane is None:
            return film, ()
        own = self.focal_plane.fov(max(width, height))
        if not _NARROWEST < own < _WIDEST:  # a wrong unit
            return film, ()
        if film is None:
            return own, ()
        ratio = tan(radians(own / 2.0)) / tan(radians(film / 2.0))
        if 1.0 / _DIFFERS < ratio < _DIFFERS:
            return own, ()
        kept = own if 1.0 / _CONTRADICTS < ratio < _CONTRADICTS else film
        note = (
            f"Its focal plane resolution says a field of view of {own:.1f} degrees, its focal "
            f"length on 35 mm film {film:.1f}: {kept:.1f} taken."
        )
        return kept, (note,)


def fov_of_film(focal_length: float, width: int, height: int) -> float:
    """Field of view across a picture's long side in degrees, from FocalLengthIn35mmFilm in mm.

    The diagonal corresponds to 43.27 mm of film (CIPA DCG-001): 28 mm are 65.5 degrees across 3:2,
    63.4 across 4:3 and 57.4 across a square.
    """
    share = max(width, height) / hypot(width, height)
    return degrees(2.0 * atan(share * _FILM_DIAGONAL / 2.0 / focal_length))


def phone_fov(width: int, height: int) -> float:
    """Field of view across a picture's long side in degrees, where the file does not state it.

    A phone's main camera (24 to 28 mm on film) sees 66 degrees across 4:3; narrower shapes are cut
    from that, so that a square sees 52.
    """
    share = min(max(width, height) / min(width, height) * 3.0 / 4.0, 1.0)
    return degrees(2.0 * atan(share * _PHONE_REACH))


def part_of_fov(fov: float, share: float) -> float:
    """Field of view in degrees across a centred part, `share` of the whole's long side."""
    return degrees(2.0 * atan(share * tan(radians(fov) / 2.0)))


def read_exif(source: Path | bytes, xmp: bytes = b"") -> Exif:
    """Read the metadata of a file, or of a block of Exif bytes.

    Absent or damaged tags have their defaults; never raises for a file's content.

    Args:
        source: an existing file, or Exif bytes.
        xmp: XMP packet that belongs to Exif bytes; ignored for a file.
    """
    if isinstance(source, bytes):
        return _interpret(exif_tags(io.BytesIO(source.removeprefix(b"Exif\0\0"))), xmp)
    with source.open("rb") as file:
        kind = kind_of(file.read(64))
        if kind is FileKind.PNG:
            return _of_png(list(png_chunks(source)))
        if kind in (FileKind.JPEG, FileKind.WEBP):
            info = pillow_info(source, kind)
            return read_exif(info.get("exif", b""), info.get("xmp", b""))
        xmp = _xmp_of(source) if kind is FileKind.TIFF else b""
        file.seek(0)
        return _interpret(exif_tags(file), xmp)


def _of_png(chunks: list[tuple[bytes, bytes]]) -> Exif:
    exif = xmp = b""
    for kind, data in chunks:
        if kind == b"eXIf":
            exif = data
        elif kind == b"iTXt" and data.startswith(b"XML:com.adobe.xmp\0"):
            xmp = _text(data)
    return read_exif(exif, xmp)


def _text(data: bytes) -> bytes:
    """Text of a PNG's iTXt chunk (PNG 3rd edition, 11.3.3.4); empty if damaged."""
    _, _, rest = data.partition(b"\0")
    text = rest[2:].split(b"\0", 2)[-1]
    if rest[:1] != b"\1":
        return text
    try:
        return zlib.decompressobj().decompress(text, _LARGEST_INFLATED)
    except zlib.error:
        return b""


def _xmp_of(path: Path) -> bytes:
    """The XMP packet of a TIFF; empty if there is none."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as tiff:
            tag = tiff.pages.first.tags.get(Tag.XMP)
            return b"" if tag is None else bytes(tag.value)[:_LARGEST_XMP]
    except Exception:  # parsers raise anything on damaged files; decoding the pixels reports them
        return b""


def _of_xmp(xmp: bytes, name: bytes) -> int:
    """An integer in XMP, as attribute or element; -1 if absent."""
    match = re.search(name + rb"\s*(?:=\s*[\"']|>)\s*(\d{1,5})\b", xmp)
    return int(match[1]) if match else -1


def _exposure(tags: dict[str, Any]) -> float | None:
    names = ("ExposureTime", "ISOSpeedRatings", "FNumber")
    time, sensitivity, aperture = (_ratio(tags, f"EXIF {name}") for name in names)
    if time is None or sensitivity is None or aperture is None:
        return None
    return time * sensitivity / aperture**2


def _camera(tags: dict[str, Any]) -> str:
    """Name of camera, lens, focal length and zoom."""
    names = ("Image Make", "Image Model", "EXIF LensModel")
    maker, model, lens = (str(getattr(tags.get(name), "values", "")).strip() for name in names)
    if not model:
        return ""
    maker = "" if model.casefold().startswith(maker.casefold()) else maker
    name = " ".join(part for part in (maker, model, lens) if part)
    length, zoom = _ratio(tags, "EXIF FocalLength"), _ratio(tags, "EXIF DigitalZoomRatio")
    name += "" if length is None else f", {length:g} mm"
    return name + ("" if zoom is None or zoom == 1.0 else f", zoom {zoom:g}")


def _focal_plane(tags: dict[str, Any]) -> FocalPlane | None:
    """FocalLength times FocalPlaneXResolution, in pixels of the picture size in Exif."""
    length = _ratio(tags, "EXIF FocalLength")
    resolution = _ratio(tags, "EXIF FocalPlaneXResolution")
    unit = _UNITS.get(_number(tags, "EXIF FocalPlaneResolutionUnit"), _UNITS[2])
    if length is None or resolution is None:
        return None
    sides = [_number(tags, f"EXIF ExifImage{side}") for side in ("Width", "Length")]
    long_side = max(sides) if min(sides) > 0 else None
    return FocalPlane(length * resolution / unit, long_side)


def _ratio(tags: dict[str, Any], name: str) -> float | None:
    """The tag's first value if it is a positive number, else None."""
    try:
        first = tags[name].values[0]
        # Numbers in floating point come as a tuple of one.
        value = float(first[0] if isinstance(first, tuple) else first)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError):
        return None
    return value if 0.0 < value < 1e9 else None


def exif_tags(file: BinaryIO) -> dict[str, Any]:
    """Exif tags of an open file by name, as exifread reads them; empty if there are none."""
    import exifread

    try:
        with quiet_decoders():  # it logs that there are none
            return exifread.process_file(file, details=False, extract_thumbnail=False)
    except Exception:  # the parser raises anything (AssertionError, struct.error, ...)
        return {}


def _interpret(tags: dict[str, Any], xmp: bytes) -> Exif:
    # Android's DNGs have them in the first directory, without one of Exif (TIFF/EP).
    first = {f"EXIF {name[6:]}": tag for name, tag in tags.items() if name.startswith("Image ")}
    tags = first | tags
    orientation = _number(tags, "Image Orientation")
    if orientation not in range(1, 9):
        orientation = _of_xmp(xmp, b"tiff:Orientation")
    film = _ratio(tags, "EXIF FocalLengthIn35mmFilm")
    if film is None:
        stated = _of_xmp(xmp, b"exif:FocalLengthIn35mmFilm")
        film = float(stated) if stated > 0 else None
    flash = _number(tags, "EXIF Flash")
    return Exif(
        orientation=orientation if orientation in range(1, 9) else 1,
        # Zero means unknown; no lens for photographs is longer than 10 m.
        film_focal_length=film if film is not None and film < 10_000 else None,
        focal_plane=_focal_plane(tags),
        flash_fired=bool(flash & 1) if flash >= 0 else None,
        exposure=_exposure(tags),
        camera=_camera(tags),
    )


def _number(tags: dict[str, Any], name: str) -> int:
    """The tag's first value as an integer, or -1."""
    try:
        return int(tags[name].values[0])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ZeroDivisionError):
        return -1
