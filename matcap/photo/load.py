"""Reads a photograph file of any supported format to a Photo: its format by the first bytes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.files.containers import FileKind, Tag, decoding, kind_of, read_head
from matcap.files.pixels import upright
from matcap.files.process import quiet_decoders
from matcap.photo.developed import read_developed
from matcap.photo.dng import Corrections, read_corrections, read_float_dng
from matcap.photo.exif import Exif, part_of_fov, phone_fov, read_exif
from matcap.photo.left_out import leave_transparent_out
from matcap.photo.photo import SHORTEST_SIDE, Decoded, Photo, ToneCurve, quarter_turn
from matcap.photo.raw import read_raw
from matcap.photo.raw_samples import raw_page

# Of RAW files other than DNG.
RAW_SUFFIXES = frozenset(
    f".{maker}"
    for maker in (
        *("3fr", "arw", "cr2", "cr3", "crw", "dcr", "erf", "fff", "gpr", "iiq", "kdc", "mef"),
        *("mos", "mrw", "nef", "nrw", "orf", "pef", "raf", "raw", "rw2", "rwl", "sr2", "srf"),
        *("srw", "x3f"),
    )
)
_READABLE = "give a DNG or other RAW, a JPEG, PNG, TIFF, HEIC, AVIF, WebP, EXR or HDR"


def file_kind(path: Path) -> FileKind:
    """Detect a photograph's format; of TIFFs, DNG by its version tag, RAW by suffix or raw picture.

    Raises:
        MatcapError: the file is missing, not a file, empty, unreadable, or not a photograph.
    """
    head = read_head(path)
    kind = kind_of(head)
    if kind is FileKind.OTHER:
        raise MatcapError.at(path, f"this is not a photograph{_guess(head)}", _READABLE)
    if kind is not FileKind.TIFF:
        return kind
    import tifffile

    with decoding(path, "TIFF"), tifffile.TiffFile(path) as file:
        if Tag.DNGVersion in file.pages.first.tags:
            return FileKind.DNG
        raw = path.suffix.lower() in RAW_SUFFIXES or raw_page(file) is not None
        return FileKind.RAW if raw else FileKind.TIFF


# Other formats by their first bytes, for error messages.
_KNOWN = {
    b"GIF8": "a GIF", b"BM": "a BMP picture", b"8BPS": "a Photoshop document",
    b"%PDF": "a PDF document",
    b"\xff\x0a": "a JPEG XL picture", b"\0\0\0\x0cJXL ": "a JPEG XL picture",
    b"\xff\x4f\xff\x51": "a JPEG 2000 picture", b"\0\0\0\x0cjP  ": "a JPEG 2000 picture",
}  # fmt: skip


def _guess(head: bytes) -> str:
    """Part of a message that names the format by the first bytes, or ""."""
    for begins, what in _KNOWN.items():
        if head.startswith(begins):
            return f" in a supported format but {what}"
    if head[4:8] == b"ftyp":
        return " but a video or another container"
    if all(byte in b"\t\n\r\f\x1b" or 32 <= byte < 127 for byte in head):
        return " but a text file"
    return ""


_DARKEST = 1e-3  # linear; a picture whose maximum is less counts as black
_MOST_CLIPPED = 0.95  # largest share of clipped pixels


def load_photo(
    path: str | Path,
    *,
    long_side: int | None = None,
    fov: float | None = None,
    noise: bool = True,
    white: float | None = None,
    tone: ToneCurve | None = None,
) -> Photo:
    """Read a photograph.

    Args:
        path: DNG or other RAW, JPEG, PNG, TIFF (8, 16 bits or float), WebP, AVIF, EXR, Radiance
            HDR, HEIC (extra `heic`). Transparent pixels are left out, as by a mask.
        long_side: downsample to this many pixels along the long side; never upsample.
        fov: field of view across the long side, degrees; None is the file's, or phone_fov().
        noise: compute Photo.noise of a RAW, for which it is developed twice.
        white: value of white in a file of floating-point numbers; None is the file's, or 1.
        tone: curve of a developed picture, if known; undone before downsampling, as a mean of
            compressed values is not that of light.

    Returns:
        The photograph in linear light, its long side along x.

    Raises:
        MatcapError: the file is not a photograph that can be used; the sentence says why.
        UsageError: long_side or fov is out of range.
    """
    path = Path(path)
    _check_request(long_side, fov, white)
    with quiet_decoders():
        picture, exif = _read(path, long_side, noise, white, tone)
    return replace(_photo(picture, exif, fov, str(path), path.name), path=path.absolute())


def _read(
    path: Path, long_side: int | None, noise: bool, white: float | None, tone: ToneCurve | None
) -> tuple[Decoded, Exif]:
    kind = file_kind(path)
    if kind not in (FileKind.RAW, FileKind.DNG):
        return read_developed(path, kind, long_side, white, tone)
    corrections = read_corrections(path) if kind is FileKind.DNG else Corrections()
    if corrections.samples == "floating":
        picture = read_float_dng(path, long_side, corrections, white)
    else:
        picture = read_raw(path, long_side, corrections, noise=noise)
    if kind is FileKind.DNG:  # whose first directory says it, not the one that LibRaw looks at
        picture = replace(picture, orientation=None)
    return picture, read_exif(path)


def _photo(picture: Decoded, exif: Exif, fov: float | None, where: str, name: str) -> Photo:
    """Check the picture, and rotate it upright, then to landscape orientation."""
    stored = picture.photo
    _check_light(stored, where)
    width, height = stored.original_size
    orientation = picture.orientation or exif.orientation
    size = (width, height) if orientation < 5 else (height, width)
    turned = size[1] > size[0]

    def lying(planes: NDArray[Any]) -> NDArray[Any]:
        standing = upright(planes, orientation)
        return np.ascontiguousarray(quarter_turn(standing) if turned else standing)

    whole = picture.whole or (width, height)
    stated, notes = exif.view(*whole)
    known, source, notes = (fov, "given", ()) if fov is not None else (stated, "exif", notes)
    seen = phone_fov(*whole) if known is None else known
    if fov is None and picture.whole is not None:
        seen = part_of_fov(seen, max(width, height) / max(whole))
    photo = replace(
        stored,
        pixels=lying(stored.pixels),
        clipped=lying(stored.clipped),
        noise=None if stored.noise is None else lying(stored.noise),
        fov=seen,
        fov_source="assumed" if known is None else source,
        name=name,
        original_size=size,
        turned=turned,
        flash_fired=exif.flash_fired,
        notes=stored.notes + notes,
        exposure=exif.exposure,
    )
    if picture.opacity is None:
        return photo
    return leave_transparent_out(photo, lying(picture.opacity), where)


def _check_request(long_side: int | None, fov: float | None, white: float | None) -> None:
    if white is not None and not 0.0 < white < math.inf:
        raise UsageError.at("white", f"{white:g} is no value of white", "give a positive number")
    if long_side is not None and long_side < SHORTEST_SIDE:
        raise UsageError.at(
            "long_side",
            f"{long_side} pixels along the long side are too few",
            f"ask for at least {SHORTEST_SIDE}",
        )
    if fov is not None and not 1.0 <= fov <= 170.0:
        raise UsageError.at(
            "fov",
            f"a field of view of {fov:g} degrees is out of range",
            "give between 1 and 170 degrees across the long side",
        )


def _check_light(picture: Photo, where: str) -> None:
    if float(picture.pixels.max()) < _DARKEST:
        raise MatcapError.at(
            where, "the picture is all black", "photograph again with the flash on"
        )
    if float(picture.clipped.mean()) > _MOST_CLIPPED:
        raise MatcapError.at(
            where,
            "the picture is all white, every pixel at the clip level",
            "photograph again with less exposure",
        )
