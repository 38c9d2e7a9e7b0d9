"""Kinds of picture files by their first bytes, refusals, and what image decoders do not return.

Of JPEG the segments, of TIFF the picture that is meant.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum, IntEnum
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

from matcap.errors import MatcapError

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
        raise MatcapError.at(path, "this is a directory", "give one picture inside it")
    try:
        if path.exists() and not path.is_file():
            raise MatcapError.at(path, "this is not a file", "give a picture")
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


def pillow_reader(kind: FileKind) -> Any:  # noqa: ANN401
    """Pillow's class of JPEG, PNG, WebP or AVIF files; its Image.open refuses large pictures.

    Raises:
        ImportError: this Pillow has none.
    """
    names = {FileKind.PNG: "Png", FileKind.WEBP: "WebP", FileKind.AVIF: "Avif"}
    name = names.get(kind, "Jpeg")
    return getattr(import_module(f"PIL.{name}ImagePlugin"), f"{name}ImageFile")


def pillow_info(path: Path, kind: FileKind) -> dict[str, Any]:
    """Metadata of a JPEG, PNG, WebP or AVIF by Pillow's names; empty if it is damaged."""
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
    notes: tuple[str, ...] = ()
    """Notes on other pages."""


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
        if photometric == WHITE_IS_ZERO and bits > 8:  # up to 8, OpenImageIO inverts them
            raise unsupported(path, f"a TIFF of {bits} bits whose least code is white")
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
            (f"The file holds {equal} pictures: the first is read.",) if equal > 1 else (),
        )
