"""Decompresses DNGs in JPEG XL (newer ProRAW), which LibRaw cannot read, to temporary copies.

tifffile decompresses the raw picture. The copy has it as one uncompressed strip, with all other
tags unchanged.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.photo.dng import raw_page
from matcap.photo.refusals import check_size, decoding, missing_extra, unreadable

if TYPE_CHECKING:
    from tifffile import TiffPage

_BITS, _COMPRESSION, _OFFSETS, _ROWS, _COUNTS, _WHITE = 258, 259, 273, 278, 279, 50717
# Predictor, tiles, JPEG tables: tags of the compression, which are dropped.
_OF_COMPRESSION = (317, 322, 323, 324, 325, 347)
_SUB_IFDS, _NONE = 330, 1
_SHORT, _LONG = 3, 4  # types of TIFF
_ENTRY = 12  # bytes

Read = TypeVar("Read")


def read_jxl(path: Path, read: Callable[[Path], Read]) -> Read:
    """Read a JPEG-XL DNG by a function for uncompressed ones.

    Raises:
        MatcapError: imagecodecs, an extra, is not installed; the file is truncated, damaged or not
            supported.
    """
    try:
        import imagecodecs  # noqa: F401  (tifffile calls it)
    except ImportError as error:
        raise missing_extra(path, "a DNG compressed with JPEG XL", "jxl") from error
    with plain_copy(path) as copy:
        try:
            return read(copy)
        except MatcapError as error:
            # Without the temporary path.
            raise MatcapError.at(path, error.what, error.remedy) from error


@contextmanager
def plain_copy(path: Path) -> Iterator[Path]:
    """Context of a temporary uncompressed copy of a DNG.

    Raises:
        MatcapError: truncated, damaged, or without a raw picture of integers in one or three
            samples.
    """
    import tifffile

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "plain.dng"
        with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
            page = raw_page(file)
            if page is None:
                raise unreadable(path, "DNG")
            check_size(path, page.imagewidth, page.imagelength)
            samples = page.asarray()
            if file.is_bigtiff or samples.dtype.kind != "u" or samples.shape[2:] not in ((), (3,)):
                raise MatcapError.at(
                    path,
                    "the DNG holds neither a mosaic nor linear colours of whole numbers",
                    "convert it with Adobe DNG Converter, without JPEG XL",
                )
            order = file.byteorder
            with copy.open("wb") as out:
                out.write(_patched(path.read_bytes(), file, page, samples, order))
                samples.astype(f"{order}u2").tofile(out)
        yield copy


def _patched(
    data: bytes,
    file: Any,  # noqa: ANN401
    page: TiffPage,
    samples: NDArray[Any],
    order: str,
) -> bytearray:
    """The file with a new directory for the raw picture, whose samples will be appended."""
    entries = {
        tag.code: data[tag.offset : tag.offset + _ENTRY]
        for tag in page.tags
        if tag.code not in _OF_COMPRESSION
    }
    planes = 1 if samples.ndim == 2 else 3
    patched = bytearray(data + bytes(len(data) % 2))
    bits_at = len(patched)
    patched += struct.pack(f"{order}4H", 16, 16, 16, 0)
    at = len(patched)
    changed = {
        _BITS: (_SHORT, planes, 16 if planes == 1 else bits_at),
        _COMPRESSION: (_SHORT, 1, _NONE),
        _ROWS: (_LONG, 1, samples.shape[0]),
        _COUNTS: (_LONG, 1, 2 * samples.size),
        _OFFSETS: (_LONG, 1, 0),
    }
    if _WHITE not in entries:
        changed[_WHITE] = (_LONG, 1, 2 ** int(page.bitspersample) - 1)
    size = 2 + _ENTRY * len(entries | changed) + 4
    changed[_OFFSETS] = (_LONG, 1, at + size)
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
        if _SUB_IFDS in each.tags:
            tag = each.tags[_SUB_IFDS]
            places += [tag.valueoffset + 4 * index for index in range(tag.count)]
    for place in places:
        if data[place : place + 4] == struct.pack(f"{order}I", page.offset):
            return place
    raise ValueError("a directory that nothing points to")
