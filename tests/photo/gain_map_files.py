"""JPEGs with HDR gain maps, written segment by segment: every number in them is the test's."""

import io
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

ISO = b"urn:iso:std:iso:ts:21496:-1\0"
XMP = b"http://ns.adobe.com/xap/1.0/\0"
APPLE = b"urn:com:apple:photo:2020:aux:hdrgainmap"


def segment(marker: int, content: bytes) -> bytes:
    return b"\xff" + bytes([marker]) + (len(content) + 2).to_bytes(2, "big") + content


def jpeg(codes: NDArray[np.uint8], segments: Sequence[bytes] = (), **options: object) -> bytes:
    """Code values (h, w) or (h, w, 3) as a JPEG with more segments at its begin."""
    file = io.BytesIO()
    options = {"quality": 100, "subsampling": 0, **options}
    Image.fromarray(codes).save(file, "JPEG", **options)
    data = file.getvalue()
    return data[:2] + b"".join(segments) + data[2:]


def hdrgm(**numbers: float | Sequence[float]) -> bytes:
    """XMP of Ultra HDR: single numbers as attributes, several as elements."""
    single = {k: v for k, v in numbers.items() if isinstance(v, (int, float, str))}
    several = {k: v for k, v in numbers.items() if k not in single}
    attributes = " ".join(f'hdrgm:{name}="{value}"' for name, value in single.items())
    elements = "".join(
        f"<hdrgm:{name}><rdf:Seq>{''.join(f'<rdf:li>{v}</rdf:li>' for v in values)}</rdf:Seq>"
        f"</hdrgm:{name}>"
        for name, values in several.items()
    )
    text = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
        f'xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" hdrgm:Version="1.0" {attributes}>'
        f"{elements}</rdf:Description></rdf:RDF></x:xmpmeta>"
    )
    return segment(0xE1, XMP + text.encode())


def iso(
    low=0.0, high=2.0, gamma=1.0, base_offset=0.0, offset=0.0, headrooms=(0.0, 2.0), more=b""
) -> bytes:
    """APP2 of ISO 21496-1 (C.2) for one channel, or for three of sequences; `more` behind it."""
    parts = np.broadcast_arrays(low, high, gamma, base_offset, offset)
    channels = parts[0].size
    scale = 10**6
    block = struct.pack(">HHB", 0, 0, 0x80 if channels == 3 else 0)
    for value in headrooms:
        block += struct.pack(">II", round(value * scale), scale)
    for numbers in zip(*(np.ravel(part) for part in parts), strict=True):
        for form, value in zip("iiIii", numbers, strict=True):
            block += struct.pack(f">{form}I", round(float(value) * scale), scale)
    return segment(0xE2, ISO + block + more)


def apple_xmp(headroom: float | None = None) -> bytes:
    stated = "" if headroom is None else f'HDRGainMap:HDRGainMapHeadroom="{headroom}"'
    text = (
        '<rdf:Description xmlns:HDRGainMap="http://ns.apple.com/HDRGainMap/1.0/" '
        f'HDRGainMap:HDRGainMapVersion="131072" {stated}/><apdi:AuxiliaryImageType>'
        f"{APPLE.decode()}</apdi:AuxiliaryImageType>"
    )
    return segment(0xE1, XMP + text.encode())


def maker_note(tag33: float, tag48: float) -> bytes:
    """Apple's maker note with two signed rationals, whose offsets count from its begin."""
    entries, values, scale = b"", b"", 10**6
    for k, (tag, value) in enumerate(((33, tag33), (48, tag48))):
        entries += struct.pack(">HHII", tag, 10, 1, 16 + 2 * 12 + 4 + 8 * k)
        values += struct.pack(">2i", round(value * scale), scale)
    return b"Apple iOS\0\0\1MM" + struct.pack(">H", 2) + entries + bytes(4) + values


def exif(orientation: int = 1, note: bytes = b"") -> Image.Exif:
    block = Image.Exif()
    block[274] = orientation
    if note:
        block.get_ifd(34665)[37500] = note
    return block


def write(path: Path, base: bytes, *pictures: bytes) -> Path:
    path.write_bytes(base + b"".join(pictures))
    return path
