"""Kinds of picture files by their first bytes, refusals, and what image decoders do not return.

Of HEIC and AVIF (ISO/IEC 14496-12 and 23008-12) the colour space as code points, by the boxes meta,
pitm, iprp, ipco and ipma; of JPEG the segments and coding modes; of TIFF the picture that is meant.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError

if TYPE_CHECKING:
    from PIL.JpegImagePlugin import JpegImageFile

APPLE_GAIN_MAP = "urn:com:apple:photo:2020:aux:hdrgainmap"  # a HEIC's auxiliary picture


class FileKind(Enum):
    """Kinds of picture files."""

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
    OTHER = "picture"


# By first bytes; a TIFF may also be a DNG or another RAW.
_MAGIC = {
    b"\xff\xd8\xff": FileKind.JPEG,
    b"\x89PNG\r\n\x1a\n": FileKind.PNG,
    b"\x76\x2f\x31\x01": FileKind.EXR,
    b"#?": FileKind.RADIANCE,
    **dict.fromkeys((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), FileKind.TIFF),
    **dict.fromkeys(
        (b"FUJIFILM", b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FOVb", b"\0MRM"), FileKind.RAW
    ),
}
# By the brands of an ISO base media file; AVIF first, as its files may have HEIC's generic brands.
_BRANDS = {
    **dict.fromkeys((b"avif", b"avis"), FileKind.AVIF),
    **dict.fromkeys(
        (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"), FileKind.HEIC
    ),
    b"crx ": FileKind.RAW,
}
_HEAD = 64  # first bytes that are read


def read_head(path: Path) -> bytes:
    """The first bytes of a file.

    Raises:
        MatcapError: the file is missing, not a file, empty, or unreadable.
    """
    if path.is_dir():
        remedy = "give one picture inside it; matcap batch takes a folder of photographs"
        raise MatcapError.at(path, "this is a folder", remedy)
    try:
        if path.exists() and not path.is_file():
            raise MatcapError.at(path, "this is a pipe or a device", "save the picture to a file")
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
        raise MatcapError.at(path, "the file is empty", "copy it again")
    return head


def kind_of(head: bytes) -> FileKind:
    """The kind of a file that begins with these bytes; of RAW files based on TIFF, TIFF."""
    if head[4:8] == b"ftyp":
        brands = {head[8:12], *(head[at : at + 4] for at in range(16, len(head), 4))}
        return next((kind for brand, kind in _BRANDS.items() if brand in brands), FileKind.OTHER)
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return FileKind.WEBP
    return next((kind for magic, kind in _MAGIC.items() if head.startswith(magic)), FileKind.OTHER)


# Refusals.

MOST_PIXELS = 2**28  # 16384 x 16384; a header may claim any size
# Words in decoders' errors for unsupported, rather than damaged, files.
_UNSUPPORTED = (
    *("unsupported", "not supported", "not implemented", "cannot handle", "no decoding"),
    "not configured",  # libtiff's, of a compression that it was built without
)


def check_pixels(path: Path, width: int, height: int) -> None:
    """Raise MatcapError for a picture of more than MOST_PIXELS."""
    if width * height > MOST_PIXELS:
        raise MatcapError.at(
            path,
            f"the picture is {width} x {height} pixels, more than can be read",
            f"reduce it to under {MOST_PIXELS // 1_000_000} megapixels",
        )


@contextmanager
def decoding(path: Path, form: str) -> Iterator[None]:
    """Context that converts a decoder's exceptions on damaged files to MatcapError.

    For calls of other libraries only, which may raise anything (struct.error, AssertionError, ...).
    """
    try:
        yield
    except MatcapError:
        raise
    except MemoryError as error:
        raise MatcapError.at(
            path,
            f"there is not enough memory to read this {form}",
            "free some memory or reduce the picture",
        ) from error
    except Exception as error:
        if any(word in str(error).lower() for word in _UNSUPPORTED):
            raise unsupported(path, f"how this {form} file is coded") from error
        raise unreadable(path, form) from error


def unreadable(path: Path, form: str) -> MatcapError:
    """The error for a truncated or damaged file."""
    return MatcapError.at(
        path, f"the {form} file is truncated or damaged", "copy, save or download it again"
    )


def unsupported(path: Path, what: str) -> MatcapError:
    """The error for a file whose coding is not supported."""
    return MatcapError.at(
        path, f"{what} is not supported", "export it as a JPEG, PNG or TIFF of 8 or 16 bits in RGB"
    )


def missing_extra(path: Path, form: str, extra: str) -> MatcapError:
    """The error for a format whose reader is not installed."""
    return MatcapError.at(
        path, f"{form} needs a package that is not installed", f'run: pip install "matcap[{extra}]"'
    )


# Properties of the primary picture of a HEIC or AVIF.


@dataclass(frozen=True)
class Properties:
    """Properties of the primary picture."""

    profile: bytes | None = None
    """ICC profile, or None."""
    code_points: tuple[int, int] | None = None
    """(primaries, transfer) of ITU-T H.273 from nclx, or None."""
    bits: int = 8
    """Bits per channel (pixi), 8 if absent."""


def primary_properties(path: Path) -> Properties:
    """Read the properties of a file's primary picture.

    Raises:
        ValueError, struct.error, LookupError, StopIteration: the file is damaged.
        OSError: the file cannot be read.
    """
    meta = next(data for name, data in _boxes(memoryview(path.read_bytes())) if name == b"meta")
    boxes = dict(_boxes(meta[4:]))  # a full box: version and flags first
    primary = boxes[b"pitm"]
    wide = primary[0] > 0
    (item,) = struct.unpack_from(">I" if wide else ">H", primary, 4)
    groups = list(_boxes(boxes[b"iprp"]))
    shared = list(_boxes(dict(groups)[b"ipco"]))
    properties = Properties()
    for name, data in groups:
        if name != b"ipma":
            continue
        for index in _of_item(data, item):
            if 0 < index <= len(shared):
                properties = _with(properties, *shared[index - 1])
    return properties


def _with(properties: Properties, name: bytes, data: memoryview) -> Properties:
    kind = bytes(data[:4]) if name == b"colr" else b""
    if kind == b"nclx":
        return replace(properties, code_points=struct.unpack_from(">2H", data, 4))
    if kind in (b"prof", b"rICC"):
        return replace(properties, profile=bytes(data[4:]))
    if name == b"pixi" and len(data) > 5:
        return replace(properties, bits=max(data[5 : 5 + data[4]]))
    return properties


def _boxes(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    at = 0
    while at + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        begun = 8
        if size == 1:
            (size,) = struct.unpack_from(">Q", data, at + 8)
            begun = 16
        elif size == 0:
            size = len(data) - at
        if size < begun:
            raise ValueError("a box shorter than its head")
        yield name, data[at + begun : at + size]
        at += size


def _of_item(data: memoryview, item: int) -> Iterator[int]:
    """Indices, from 1, of the properties of an item in an ipma box."""
    version, wide = data[0], data[3] & 1
    (count,) = struct.unpack_from(">I", data, 4)
    at = 8
    for _ in range(count):
        (each,) = struct.unpack_from(">H" if version < 1 else ">I", data, at)
        at += 2 if version < 1 else 4
        links = data[at]
        at += 1
        for _ in range(links):
            (index,) = struct.unpack_from(">H" if wide else ">B", data, at)
            at += 2 if wide else 1
            if each == item:
                yield index & (0x7FFF if wide else 0x7F)


# Detects JPEG coding modes that common decoders do not support (ITU-T T.81, table B.1).

_FRAMES = (0xC0, 0xC1, 0xC2, 0xC9, 0xCA)
_LOSSLESS_OR_HIERARCHICAL = (0xC3, 0xC5, 0xC6, 0xC7, 0xCB, 0xCD, 0xCE, 0xCF)


def unsupported_jpeg(path: Path) -> str:
    """The coding mode, such as "JPEG of 12 bits", if it is not supported; else ""."""
    with path.open("rb") as file:
        for marker, data in jpeg_segments(file):
            if marker in _LOSSLESS_OR_HIERARCHICAL:
                return "lossless or hierarchical JPEG"
            if marker in _FRAMES:
                return f"JPEG of {data[0]} bits" if data and data[0] != 8 else ""
    return ""


# JPEGs that lack their end marker alone, as copies and network cameras leave them.

_NO_END = "The JPEG lacks its end marker; all of its picture is there."
_END = b"\xff\xd9"
# Appended in turn: where a picture lacks codes, they decode to different ones.
_FILLERS = (b"", b"\x5a" * 64, b"\xa5\x13" * 64)


def loaded_jpeg(image: JpegImageFile, path: Path) -> tuple[JpegImageFile, tuple[str, ...]]:
    """A JPEG file with its pixels decoded, and a note if only its end marker was missing.

    Raises:
        OSError: it is truncated.
    """
    try:
        image.load()
    except OSError:
        whole = _with_end(path)
        if whole is None:
            raise
        image = type(image)(io.BytesIO(whole))
        image.load()
        return image, (_NO_END,)
    return image, ()


def _with_end(path: Path) -> bytes | None:
    """A JPEG's bytes with an end marker, if that is all it lacks; else None."""
    from PIL.JpegImagePlugin import JpegImageFile

    data = path.read_bytes().rstrip(b"\0\xff")
    if _END in data[data.rfind(b"\xff\xda") :]:
        return None
    pictures = (JpegImageFile(io.BytesIO(data + filler + _END)) for filler in _FILLERS)
    try:
        same = len({picture.tobytes() for picture in pictures}) == 1
    except (OSError, SyntaxError, ValueError):
        return None
    return data + _END if same else None


def pillow_reader(kind: FileKind) -> Any:  # noqa: ANN401
    """Pillow's class of JPEG, WebP or AVIF files; its Image.open refuses large pictures.

    Raises:
        ImportError: this Pillow has none.
    """
    name = {FileKind.WEBP: "WebP", FileKind.AVIF: "Avif"}.get(kind, "Jpeg")
    return getattr(import_module(f"PIL.{name}ImagePlugin"), f"{name}ImageFile")


def pillow_info(path: Path, kind: FileKind) -> dict[str, Any]:
    """Metadata of a JPEG or WebP by Pillow's names, wherever they stand; empty if it is damaged."""
    try:
        with path.open("rb") as file:
            return dict(pillow_reader(kind)(file).info)
    except Exception:  # Pillow raises anything on broken bytes; decoding the pixels reports them
        return {}


def jpeg_segments(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """(marker, data) of a JPEG's segments before its scan, up to where the file is damaged.

    The file is read from its present position, the start of a JPEG, and left behind the segments.
    """
    file.seek(2, 1)
    while len(head := file.read(2)) == 2 and head[0] == 0xFF:
        if head[1] == 0xFF:  # a fill byte
            file.seek(-1, 1)
            continue
        length = int.from_bytes(file.read(2), "big")
        if head[1] in (0xD9, 0xDA) or length < 2:
            return
        yield head[1], file.read(length - 2)


class Tag(IntEnum):
    """Tags of TIFF, Exif and DNG files, by the names in their standards.

    TIFF 6.0 with its supplements, TIFF/EP, Exif 2.32, and DNG 1.7.
    """

    Orientation = 274
    WhitePoint = 318
    PrimaryChromaticities = 319
    XMP = 700
    CFARepeatPatternDim = 33421
    CFAPattern = 33422
    ExifIFD = 34665
    InterColorProfile = 34675
    MakerNote = 37500
    ColorSpace = 40961
    InteroperabilityIFD = 40965
    DNGVersion = 50706
    LinearizationTable = 50712
    BlackLevelRepeatDim = 50713
    BlackLevel = 50714
    BlackLevelDeltaH = 50715
    BlackLevelDeltaV = 50716
    WhiteLevel = 50717
    DefaultCropOrigin = 50719
    DefaultCropSize = 50720
    ColorMatrix1 = 50721
    ColorMatrix2 = 50722
    CameraCalibration1 = 50723
    CameraCalibration2 = 50724
    AnalogBalance = 50727
    AsShotNeutral = 50728
    AsShotWhiteXY = 50729
    CalibrationIlluminant1 = 50778
    CalibrationIlluminant2 = 50779
    ActiveArea = 50829
    MaskedAreas = 50830
    CameraCalibrationSignature = 50931
    ProfileCalibrationSignature = 50932
    ForwardMatrix1 = 50964
    ForwardMatrix2 = 50965
    RowInterleaveFactor = 50975
    OpcodeList1 = 51008
    OpcodeList2 = 51009
    OpcodeList3 = 51022
    DefaultUserCrop = 51125
    ColumnInterleaveFactor = 52547


# TIFF 6.0, and the supplements 1 and 2: PhotometricInterpretation.
WHITE_IS_ZERO, GREYS, _MASK = 0, (0, 1), 4
_NO_RGB = {5: "CMYK", 8: "CIELAB", 9: "ICCLAB"}
_REDUCED, _IS_MASK = 1, 4  # bits of NewSubfileType
_MOST_PAGES = 64  # read at most; a damaged file may claim any number
_FORMATS, _FLOATING = (1, 2, 3, 4), 3  # SampleFormat: unsigned, signed, floating, undefined
_JPEGS = (6, 7)  # compressions
# Compressions that every OpenImageIO decodes; a failure with others means unsupported.
_USUAL = {1, 2, 3, 4, 5, 6, 7, 8, 32771, 32773, 32946}


@dataclass(frozen=True)
class TiffPicture:
    """The picture of a TIFF file that is read; the defaults are another format's only one."""

    index: int = 0
    """Index of its page."""
    compression: str = ""
    """Name of its compression, if not every OpenImageIO decodes that; else ""."""
    white_is_zero: bool = False
    """Whether the least code is white."""
    notes: tuple[str, ...] = ()
    """Notes on other pages."""

    def as_meant(self, stored: NDArray[Any], alpha: int) -> NDArray[Any]:
        """Values (H, W, C) as OpenImageIO reads them, with stored white as the largest value.

        Where WhiteIsZero, OpenImageIO inverts all channels of up to 8 bits, and none of others.

        Args:
            alpha: index of the channel of alpha, or negative.
        """
        if not self.white_is_zero:
            return stored
        eight = stored.dtype == np.uint8
        wrong = [c for c in range(stored.shape[-1]) if (c == alpha) == eight]
        largest = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
        stored[..., wrong] = stored.dtype.type(largest) - stored[..., wrong]
        return stored


def meant_picture(path: Path) -> TiffPicture:
    """The largest page that is neither a thumbnail nor a mask, the first of equals.

    Raises:
        MatcapError: it is of a kind that is not supported.
        Exception: of any kind where the file is damaged.
    """
    import tifffile

    with tifffile.TiffFile(path) as file:
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
        photometric, code = int(page.photometric), int(page.compression)
        bits, form, bands = (
            int(one) for one in (page.bitspersample, page.sampleformat, page.samplesperpixel)
        )
        if form not in _FORMATS or (form == _FLOATING and bits not in (16, 32, 64)):
            raise unsupported(path, f"a TIFF of {bits} bits in sample format {form}")
        if any(sub.imagewidth * sub.imagelength > sizes[chosen] for sub in inside):
            raise unsupported(
                path, "a TIFF whose picture is in a sub-directory behind a smaller one"
            )
        if photometric in _NO_RGB:
            raise unsupported(path, f"a TIFF of {_NO_RGB[photometric]} colours")
        if photometric in GREYS and bands > 4:
            raise unsupported(
                path, f"a TIFF of {bands} bands that are not named red, green and blue"
            )
        usual = code in _USUAL and not (code in _JPEGS and bits != 8)
        equal = sum(sizes[index] == sizes[chosen] for index in whole)
        return TiffPicture(
            chosen,
            "" if usual else str(getattr(page.compression, "name", code)).upper(),
            photometric == WHITE_IS_ZERO,
            (f"The file holds {equal} pictures: the first is read.",) if equal > 1 else (),
        )
