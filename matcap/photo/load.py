"""Reads a photograph file of any supported format to a Photo: its format by the first bytes."""

from __future__ import annotations

import math
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.files.containers import Tag
from matcap.files.exr import MAGIC
from matcap.files.pixels import upright
from matcap.files.process import quiet_decoders
from matcap.photo.developed import read_heic, read_jpeg, read_webp_or_avif
from matcap.photo.dng import Corrections, raw_page, read_corrections
from matcap.photo.exif import Exif, part_of_fov, phone_fov, read_exif
from matcap.photo.left_out import leave_transparent_out
from matcap.photo.lossless import (
    is_float_dng,
    read_exr_or_radiance,
    read_float_dng,
    read_png_or_tiff,
)
from matcap.photo.photo import (
    READABLE,
    SHORTEST_SIDE,
    Decoded,
    Photo,
    ToneCurve,
    check_size,
    decoding,
    missing_extra,
    quarter_turn,
    unreadable,
)
from matcap.photo.raw import read_raw
from matcap.photo.raw_samples import DONE, normalised

if TYPE_CHECKING:
    from tifffile import TiffPage


class FileKind(Enum):
    """Formats of photographs."""

    RAW = "RAW"
    DNG = "DNG"
    JPEG = "JPEG"
    PNG = "PNG"
    TIFF = "TIFF"
    HEIC = "HEIC"
    AVIF = "AVIF"
    WEBP = "WebP"
    EXR = "EXR"
    RADIANCE = "Radiance HDR"


_EXR = b"\x76\x2f\x31\x01"
_JPEG = b"\xff\xd8\xff"
_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_RAW = (b"FUJIFILM", b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FOVb", b"\0MRM")
_HEIC_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}
_AVIF_BRANDS = {b"avif", b"avis"}
# Of RAW files other than DNG.
RAW_SUFFIXES = frozenset(
    f".{maker}"
    for maker in (
        *("3fr", "arw", "cr2", "cr3", "crw", "dcr", "erf", "fff", "gpr", "iiq", "kdc", "mef"),
        *("mos", "mrw", "nef", "nrw", "orf", "pef", "raf", "raw", "rw2", "rwl", "sr2", "srf"),
        *("srw", "x3f"),
    )
)
_HEAD = 64  # first bytes that are read


def file_kind(path: Path) -> FileKind:
    """Detect a file's format.

    Raises:
        MatcapError: the file is missing, not a file, empty, unreadable, or not a photograph.
    """
    head = _head(path)
    if head.startswith(_JPEG):
        return FileKind.JPEG
    if head.startswith(_PNG):
        return FileKind.PNG
    if head.startswith(_EXR):
        return FileKind.EXR
    if head.startswith(MAGIC):
        return FileKind.RADIANCE
    if head[4:8] == b"ftyp":
        brands = {head[8:12], *(head[at : at + 4] for at in range(16, len(head), 4))}
        # AVIF first, as AVIF files may have HEIC's generic brands.
        if brands & _AVIF_BRANDS:
            return FileKind.AVIF
        if brands & _HEIC_BRANDS:
            return FileKind.HEIC
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return FileKind.WEBP
    if head[4:12] == b"ftypcrx " or head.startswith(_RAW):
        return FileKind.RAW
    if head.startswith(_TIFF):
        return _of_tiff(path)
    raise MatcapError.at(path, f"this is not a photograph{_guess(head)}", READABLE)


def _head(path: Path) -> bytes:
    if path.is_dir():
        raise MatcapError.at(path, "this is a directory", "give one photograph inside it")
    try:
        if path.exists() and not path.is_file():
            raise MatcapError.at(path, "this is not a file", READABLE)
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except FileNotFoundError as error:
        raise MatcapError.at(path, "there is no such file", "check the name") from error
    except PermissionError as error:
        raise MatcapError.at(path, "the file may not be read", "change its permissions") from error
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        raise MatcapError.at(
            path,
            f"the file cannot be read ({getattr(error, 'strerror', None) or error})",
            "check the disk and the name",
        ) from error
    if not head:
        raise MatcapError.at(path, "the file is empty", "copy it from the camera again")
    return head


def _of_tiff(path: Path) -> FileKind:
    """The format of a TIFF: DNG by its version tag, RAW by its suffix or by a raw picture."""
    import tifffile

    with decoding(path, "TIFF"), tifffile.TiffFile(path) as file:
        if Tag.DNGVersion in file.pages.first.tags:
            return FileKind.DNG
        if path.suffix.lower() in RAW_SUFFIXES or raw_page(file) is not None:
            return FileKind.RAW
        return FileKind.TIFF


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


# Rewrites DNGs that LibRaw cannot read (JPEG XL, of newer ProRAW) or misreads, to temporary copies.
#
# tifffile decompresses the raw picture. The copy has it as one uncompressed strip, normalised if
# LibRaw would misread it (raw_samples.py), with all other tags unchanged.


# Black and white of normalised mosaics, so that noise below black is kept.
_PEDESTAL, _LARGEST = 4096, 65535
_AS_STORED = Corrections()
# Tags of the compression, which are dropped.
_OF_COMPRESSION = (
    *(Tag.Predictor, Tag.TileWidth, Tag.TileLength, Tag.TileOffsets, Tag.TileByteCounts),
    Tag.JPEGTables,
)
_NONE = 1  # a compression
_SHORT, _LONG = 3, 4  # types of TIFF
_ENTRY = 12  # bytes

Read = TypeVar("Read")


def read_rewritten(path: Path, read: Callable[[Path], Read], corrections: Corrections) -> Read:
    """Read a DNG that LibRaw cannot read, or misreads, by a function for plain ones.

    Raises:
        MatcapError: imagecodecs, an extra, is not installed; the file is truncated, damaged or not
            supported.
    """
    with plain_copy(path, corrections) as copy:
        try:
            return read(copy)
        except MatcapError as error:
            # Without the temporary path.
            raise MatcapError.at(path, error.what, error.remedy) from error


def _check_decoder(path: Path) -> None:
    try:
        import imagecodecs  # noqa: F401  (tifffile calls it)
    except ImportError as error:
        form = "a DNG compressed with JPEG XL or lossy JPEG"
        raise missing_extra(path, form, "jxl") from error


@contextmanager
def plain_copy(path: Path, corrections: Corrections = _AS_STORED) -> Iterator[Path]:
    """Context of a temporary uncompressed copy of a DNG, its samples normalised if they need it.

    Raises:
        MatcapError: truncated, damaged, without a raw picture of integers in one or three samples,
            or imagecodecs is not installed.
    """
    import tifffile

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "plain.dng"
        with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
            page: Any = raw_page(file)
            if page is None:
                raise unreadable(path, "DNG")
            check_size(path, page.imagewidth, page.imagelength)
            if int(page.compression) != _NONE:
                _check_decoder(path)
            levels = None
            if corrections.normalised:
                samples = normalised(page, corrections.value_maps)
                levels = (_PEDESTAL if samples.ndim == 2 else 0, _LARGEST)
                span = _LARGEST - levels[0]
                samples = np.clip(np.rint(levels[0] + samples * span), 0, _LARGEST)
                samples = samples.astype(np.uint16)
            else:
                samples = page.asarray()
            if file.is_bigtiff or samples.dtype.kind != "u" or samples.shape[2:] not in ((), (3,)):
                raise MatcapError.at(
                    path,
                    "the DNG holds neither a mosaic nor linear colours of whole numbers",
                    "convert it with Adobe DNG Converter, without JPEG XL",
                )
            order = file.byteorder
            with copy.open("wb") as out:
                out.write(_patched(path.read_bytes(), file, page, samples, levels))
                samples.astype(f"{order}u2").tofile(out)
        yield copy


def _patched(
    data: bytes,
    file: Any,  # noqa: ANN401
    page: TiffPage,
    samples: NDArray[Any],
    levels: tuple[int, int] | None,
) -> bytearray:
    """The file with a new directory for the raw picture, whose samples will be appended.

    Args:
        levels: black and white of normalised samples, or None where the file's are right.
    """
    order = str(file.byteorder)
    dropped = _OF_COMPRESSION if levels is None else (*_OF_COMPRESSION, *DONE)
    entries = {
        tag.code: data[tag.offset : tag.offset + _ENTRY]
        for tag in page.tags
        if tag.code not in dropped
    }
    planes = 1 if samples.ndim == 2 else 3
    patched = bytearray(data + bytes(len(data) % 2))
    bits_at = len(patched)
    patched += struct.pack(f"{order}4H", 16, 16, 16, 0)
    at = len(patched)
    changed = {
        Tag.BitsPerSample: (_SHORT, planes, 16 if planes == 1 else bits_at),
        Tag.Compression: (_SHORT, 1, _NONE),
        Tag.RowsPerStrip: (_LONG, 1, samples.shape[0]),
        Tag.StripByteCounts: (_LONG, 1, 2 * samples.size),
        Tag.StripOffsets: (_LONG, 1, 0),
    }
    if levels is not None:
        changed |= {
            Tag.ImageWidth: (_LONG, 1, samples.shape[1]),
            Tag.ImageLength: (_LONG, 1, samples.shape[0]),
            Tag.BlackLevel: (_LONG, 1, levels[0]),
            Tag.WhiteLevel: (_LONG, 1, levels[1]),
        }
    elif Tag.WhiteLevel not in entries:
        changed[Tag.WhiteLevel] = (_LONG, 1, 2 ** int(page.bitspersample) - 1)
    size = 2 + _ENTRY * len(entries | changed) + 4
    changed[Tag.StripOffsets] = (_LONG, 1, at + size)
    for code, (kind, count, value) in changed.items():
        form = "HH" if kind == _SHORT and count == 1 else "I"
        stored = struct.pack(f"{order}{form}", *((value, 0) if form == "HH" else (value,)))
        entries[code] = struct.pack(f"{order}HHI", code, kind, count) + stored
    patched += struct.pack(f"{order}H", len(entries))
    patched += b"".join(entries[code] for code in sorted(entries)) + bytes(4)
    pointer = _pointer(data, file, page, order)
    patched[pointer : pointer + 4] = struct.pack(f"{order}I", at)
    return patched


def _pointer(data: bytes, file: Any, page: TiffPage, order: str) -> int:  # noqa: ANN401
    """Position of the offset that points to a page's directory.

    Raises:
        ValueError: it is not in a known place.
    """
    places = [4]  # of the first page
    for each in file.pages:
        places.append(each.offset + 2 + _ENTRY * len(each.tags))
        if Tag.SubIFDs in each.tags:
            tag = each.tags[Tag.SubIFDs]
            places += [tag.valueoffset + 4 * index for index in range(tag.count)]
    for place in places:
        if data[place : place + 4] == struct.pack(f"{order}I", page.offset):
            return place
    raise ValueError("a directory that nothing points to")


# Reads a photograph file of any supported format to a Photo.

_DARKEST = 1e-3  # linear; a picture whose maximum is less counts as black
_MOST_CLIPPED = 0.95  # largest share of clipped pixels


def load_photo(
    path: str | Path,
    *,
    long_side: int | None = None,
    fov: float | None = None,
    noise: bool = True,
    white: float | None = None,
) -> Photo:
    """Read a photograph.

    Args:
        path: DNG or other RAW, JPEG, PNG, TIFF (8, 16 bits or float), WebP, AVIF, EXR, Radiance
            HDR, HEIC (extra `heic`). Transparent pixels are left out, as by a mask.
        long_side: downsample to this many pixels along the long side; never upsample.
        fov: field of view across the long side, degrees; None is the file's, or phone_fov().
        noise: compute Photo.noise of a RAW, for which it is developed twice.
        white: value of white in a file of floating-point numbers; None is the file's, or 1.

    Returns:
        The photograph in linear light, its long side along x.

    Raises:
        MatcapError: the file is not a photograph that can be used; the sentence says why.
        UsageError: long_side or fov is out of range.
    """
    path = Path(path)
    _check_request(long_side, fov, white)
    with quiet_decoders():
        picture, exif = _read(path, long_side, noise, white)
    return replace(_photo(picture, exif, fov, str(path), path.name), path=path.absolute())


def _read(
    path: Path, long_side: int | None, noise: bool, white: float | None
) -> tuple[Decoded, Exif]:
    kind = file_kind(path)
    if kind is FileKind.JPEG:
        return read_jpeg(path, long_side)
    if kind is FileKind.HEIC:
        return read_heic(path, long_side)
    if kind in (FileKind.WEBP, FileKind.AVIF):
        return read_webp_or_avif(path, kind.value, long_side)
    if kind in (FileKind.PNG, FileKind.TIFF):
        return read_png_or_tiff(path, kind.value, long_side, white)
    if kind in (FileKind.EXR, FileKind.RADIANCE):
        return read_exr_or_radiance(path, long_side, white), Exif()
    corrections = read_corrections(path) if kind is FileKind.DNG else Corrections()
    if kind is FileKind.DNG and is_float_dng(path):
        return read_float_dng(path, long_side, corrections, white)
    read = partial(read_raw, long_side=long_side, corrections=corrections, noise=noise)
    picture = read_rewritten(path, read, corrections) if corrections.rewritten else read(path)
    orientation = corrections.orientation or picture.orientation
    return replace(picture, orientation=orientation), read_exif(path)


def _photo(
    picture: Decoded,
    exif: Exif,
    fov: float | None,
    where: str,
    name: str,
) -> Photo:
    """Check the picture, and rotate it upright, then to landscape orientation."""
    _check_light(picture, where)
    size = picture.size if picture.orientation < 5 else picture.size[::-1]
    turned = size[1] > size[0]

    def lying(stored: NDArray[Any]) -> NDArray[Any]:
        standing = upright(stored, picture.orientation)
        return np.ascontiguousarray(quarter_turn(standing) if turned else standing)

    whole = picture.whole or picture.size
    stated, said = exif.view(*whole)
    known, source, said = (fov, "given", ()) if fov is not None else (stated, "exif", said)
    seen = phone_fov(*whole) if known is None else known
    if fov is None and picture.whole is not None:
        seen = part_of_fov(seen, max(picture.size) / max(whole))
    photo = Photo(
        pixels=lying(picture.pixels),
        clipped=lying(picture.clipped),
        fov=seen,
        fov_source="assumed" if known is None else source,
        radiometric=picture.radiometric,
        name=name,
        original_size=size,
        turned=turned,
        flash_fired=exif.flash_fired,
        gain_map_applied=picture.gain_map_applied,
        notes=picture.notes + said,
        stored_clipped_share=picture.clipped_share,
        noise=None if picture.noise is None else lying(picture.noise),
        exposure=exif.exposure,
        balance=picture.balance,
        tone=ToneCurve() if picture.linear else None,
        headroom=picture.headroom,
        floating=picture.floating,
        development=picture.development,
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


def _check_light(picture: Decoded, where: str) -> None:
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
