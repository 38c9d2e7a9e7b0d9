"""Detects a photograph's format by its first bytes; by suffix only for RAW files that are TIFFs."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from matcap.errors import MatcapError
from matcap.files.containers import Tag
from matcap.files.exr import MAGIC
from matcap.photo.dng import raw_page
from matcap.photo.photo import READABLE, decoding


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
