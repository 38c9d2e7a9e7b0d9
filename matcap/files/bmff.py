"""Properties of the primary picture of HEIC and AVIF files (ISO/IEC 14496-12 and 23008-12).

Reads what image decoders do not return: the colour space as code points, and the camera's
intrinsic matrix. Only the boxes meta, pitm, iprp, ipco and ipma are parsed.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

_MOST = 1 << 26  # bytes of a meta box; larger ones are not read, as a header may claim any size


@dataclass(frozen=True)
class Properties:
    """Properties of the primary picture."""

    profile: bytes | None = None
    """ICC profile, or None."""
    code_points: tuple[int, int] | None = None
    """(primaries, transfer) of ITU-T H.273 from nclx, or None."""
    focal_length: float | None = None
    """From the camera matrix (cmin), in widths of the stored picture, or None."""
    bits: int = 8
    """Bits per channel (pixi), 8 if absent."""
    sideways: bool = False
    """Whether decoding rotates the stored picture by 90 or 270 degrees (irot)."""


def primary_properties(path: Path) -> Properties:
    """Read the properties of a file's primary picture.

    Raises:
        ValueError, struct.error, IndexError: the file is damaged.
        OSError: the file cannot be read.
    """
    meta = _meta(path)[4:]  # a full box: version and flags first
    boxes = dict(_boxes(meta))
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


def _with(properties: Properties, name: bytes, data: bytes) -> Properties:
    if name == b"colr" and data[:4] == b"nclx":
        return replace(properties, code_points=struct.unpack_from(">2H", data, 4))
    if name == b"colr" and data[:4] in (b"prof", b"rICC"):
        return replace(properties, profile=data[4:])
    if name == b"irot":
        return replace(properties, sideways=bool(data[0] & 1))
    if name == b"pixi" and len(data) > 5:
        return replace(properties, bits=max(data[5 : 5 + data[4]]))
    if name == b"cmin":
        # Flags: bits 8 to 12 are log2 of the denominator (ISO/IEC 23008-12, 6.5.43).
        flags = int.from_bytes(data[1:4], "big")
        (focal_length,) = struct.unpack_from(">i", data, 4)
        widths = focal_length / (1 << (flags >> 8 & 31))
        return replace(properties, focal_length=widths if widths > 0.0 else None)
    return properties


def _meta(path: Path) -> bytes:
    with path.open("rb") as file:
        while len(head := file.read(8)) == 8:
            size, name = struct.unpack(">I4s", head)
            begun = 8
            if size == 1:
                (size,) = struct.unpack(">Q", file.read(8))
                begun = 16
            if name == b"meta" and begun <= size <= _MOST:
                return file.read(size - begun)
            if size < begun:
                break
            file.seek(size - begun, 1)
    raise ValueError("no meta box")


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
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


def _of_item(data: bytes, item: int) -> Iterator[int]:
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
