"""Segments of JPEG files, coding modes that are not supported, and files without an end marker."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

# Detects JPEG coding modes that common decoders do not support (ITU-T T.81, table B.1).


_LOSSLESS_OR_HIERARCHICAL = (0xC3, 0xC5, 0xC6, 0xC7, 0xCB, 0xCD, 0xCE, 0xCF)


def unsupported_jpeg(path: Path) -> str:
    """The coding mode, such as "JPEG of 12 bits", if it is not supported; else ""."""
    with path.open("rb") as file:
        file.seek(2)
        while len(marker := file.read(2)) == 2:
            if marker[0] != 0xFF or marker[1] == 0xDA:
                return ""
            if marker[1] == 0xFF:  # a fill byte
                file.seek(-1, 1)
                continue
            if marker[1] in range(0xC0, 0xD0) and marker[1] not in (0xC4, 0xC8, 0xCC):
                bits = file.read(3)[-1:]
                if marker[1] in _LOSSLESS_OR_HIERARCHICAL:
                    return "lossless or hierarchical JPEG"
                return f"JPEG of {bits[0]} bits" if bits and bits[0] != 8 else ""
            length = int.from_bytes(file.read(2), "big")
            file.seek(max(length - 2, 0), 1)
    return ""


# JPEGs that lack their end marker alone, as copies and network cameras leave them.

NO_END = "The JPEG lacks its end marker; all of its picture is there."
_END = b"\xff\xd9"
# Appended in turn: where a picture lacks codes, they decode to different ones.
_FILLERS = (b"", b"\x5a" * 64, b"\xa5\x13" * 64)


def with_end(path: Path) -> bytes | None:
    """A JPEG's bytes with an end marker, if that is all it lacks; else None."""
    from PIL.JpegImagePlugin import JpegImageFile

    data = path.read_bytes().rstrip(b"\0\xff")
    if _END in data[data.rfind(b"\xff\xda") :]:
        return None
    first = None
    for filler in _FILLERS:
        try:
            picture = JpegImageFile(io.BytesIO(data + filler + _END))
            picture.load()
        except (OSError, SyntaxError, ValueError):
            return None
        codes = picture.tobytes()
        if first is not None and codes != first:
            return None
        first = codes
    return data + _END


# Segments, wherever metadata stand in them.


def jpeg_segments(path: Path) -> Iterator[tuple[int, bytes]]:
    """(marker, data) of a JPEG's segments before its scan, up to where the file is damaged."""
    with path.open("rb") as file:
        file.seek(2)
        while len(head := file.read(2)) == 2 and head[0] == 0xFF:
            if head[1] == 0xFF:  # a fill byte
                file.seek(-1, 1)
                continue
            length = int.from_bytes(file.read(2), "big")
            if head[1] in (0xD9, 0xDA) or length < 2:
                return
            yield head[1], file.read(length - 2)
