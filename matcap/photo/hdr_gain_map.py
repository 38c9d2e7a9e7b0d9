"""HDR gain maps: how far the light of each place exceeds the picture that a file shows.

With base light B, decoded by its own colour space, the map's value m in [0, 1], and per channel
the minimum and maximum of log2 gain, gamma, and the offsets k of base and HDR picture,

    L = (B + k_base) 2^(min + (max - min) m^(1 / gamma)) - k_hdr

(ISO 21496-1; Ultra HDR 1.1), at full headroom. Apple's own form, with the headroom H from maker
notes or XMP and m by its curve of Rec.709 or its profile, is L = B (1 + (H - 1) m)
("Applying Apple HDR effect to your photos").

| container | map | numbers |
| --- | --- | --- |
| JPEG | a JPEG behind the first | its APP2 (ISO), XMP hdrgm, XMP HDRGainMap |
| HEIC | auxiliary picture `urn:com:apple:photo:2020:aux:hdrgainmap` | maker notes 33 and 48, XMP |

Not read: maps of HEIC and AVIF as `tmap` items, which libheif and libavif do not return; maps whose
base is the brighter picture.
"""

from __future__ import annotations

import io
import math
import mmap
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.files.color import ColorSpace, rec709_decode
from matcap.files.containers import APPLE_GAIN_MAP, Tag, jpeg_segments
from matcap.files.pixels import Pixels
from matcap.files.stated_color import lineariser_of

NAME = "HDR gain map"  # in all notes on one
# Of files that have a gain map: Ultra HDR and Adobe, Apple, ISO 21496-1.
_MARKS = (b"ns.adobe.com/hdr-gain-map", b"aux:hdrgainmap", b"iso:ts:21496:-1")
_ISO = b"urn:iso:std:iso:ts:21496:-1\0"
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_SOI = b"\xff\xd8\xff"
# Flags; the last two are libultrahdr's.
_MULTICHANNEL, _BACKWARD, _COMMON_DENOMINATOR = 0x80, 0x04, 0x08
_MAKER_HEADROOM, _MAKER_GAIN = 33, 48
_MOST_STOPS = 16.0  # of a plausible gain
_OFF = 1.5  # pixels of the map by which its shape may differ from the base's, by rounding
_FINE, _SMOOTH = 64, 2.0  # parts of a code; pixels of the map, standard deviation of a blur
_FULL_GAIN = 0.995  # share of the largest gain from which on the HDR picture is at its limit


@dataclass(frozen=True)
class HdrGainMap:
    """A gain map on its own grid, and its numbers."""

    codes: NDArray[np.uint8] | NDArray[np.uint16]
    """(h, w, 1 or 3) stored values; of a resized map _FINE times as large."""
    gains: NDArray[np.float32]
    """(256 or more, 1 or 3) factor by code and channel; not decreasing."""
    base_offset: NDArray[np.float32]
    """(1 or 3,) added to base light."""
    offset: NDArray[np.float32]
    """(1 or 3,) subtracted from the result."""
    form: str = ""
    """Standard, for notes."""

    @cached_property
    def headroom(self) -> float:
        """Light of the brightest code that the file can state, in units of white."""
        return float(((1.0 + self.base_offset) * self.gains[-1] - self.offset).min())

    def fits(self, width: int, height: int) -> bool:
        """Whether the map has the shape of a base picture."""
        rows, columns = self.codes.shape[:2]
        return abs(rows - height * columns / width) <= _OFF * max(1.0, height / width)

    def resized(self, width: int, height: int) -> HdrGainMap:
        """The map on the grid of the base picture, bilinearly, in _FINE parts of a code.

        A code is a percent of light and more, whose steps show on smooth material: where a blur
        would be rounded to the stored code, it is the value that was rounded.
        """
        import cv2

        stored = self.codes.astype(np.float32)
        smooth = cv2.GaussianBlur(stored, (0, 0), _SMOOTH).reshape(stored.shape)
        codes = np.rint(_FINE * np.where(np.abs(smooth - stored) <= 0.5, smooth, stored))
        codes = cv2.resize(codes.astype(np.uint16), (width, height), interpolation=cv2.INTER_LINEAR)
        parts = np.arange(255 * _FINE + 1) / _FINE
        gains = [np.interp(parts, np.arange(256), each) for each in self.gains.T]
        return replace(
            self,
            codes=np.asarray(codes, np.uint16).reshape(height, width, -1),
            gains=np.stack(gains, axis=1).astype(np.float32),
        )

    def light(
        self, base: NDArray[np.float32], rows: slice
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Light (n, W, 3) of the base's light in rows, and (n, W) where the gain is the largest.

        The map must be on the grid of the base (resized).
        """
        import cv2

        codes, last = self.codes[rows], self.gains.shape[1] - 1
        gain = [
            np.take(np.ascontiguousarray(self.gains[:, min(k, last)]), codes[..., k], mode="clip")
            for k in range(codes.shape[2])
        ]
        light = base + self.base_offset if self.base_offset.any() else base
        light = light * np.asarray(cv2.merge(gain * (3 // len(gain))), np.float32)
        if self.offset.any():
            light = np.maximum(light - self.offset, 0.0)
        full = np.asarray((codes >= self._full_code).any(axis=-1), np.bool_)
        return np.asarray(light, np.float32), full

    @cached_property
    def _full_code(self) -> NDArray[np.int64]:
        """(1 or 3,) least code at which the gain is the largest."""
        return np.argmax(self.gains >= _FULL_GAIN * self.gains[-1], axis=0)


_Numbers = tuple[NDArray[np.float64], ...]
"""Least and largest log2 gain, gamma, offsets of base and HDR picture, (1 or 3,) each."""


def _map_of(codes: NDArray[np.uint8], numbers: _Numbers, form: str) -> HdrGainMap:
    """The gain map of stored values (h, w, 1 or 3), by ISO 21496-1.

    Raises:
        ValueError: the numbers are implausible.
    """
    low, high, gamma, base_offset, offset = numbers
    if not all(np.isfinite(each).all() for each in numbers) or (gamma <= 0.0).any():
        raise ValueError("its numbers are damaged")
    if (high < low).any() or np.abs([low, high]).max() > _MOST_STOPS:
        raise ValueError("its numbers are damaged")
    if len(low) > codes.shape[2]:
        codes = np.repeat(codes, len(low), axis=2)
    stops = low + (high - low) * (np.arange(256) / 255.0)[:, None] ** (1.0 / gamma)
    gains = np.repeat(np.exp2(stops), codes.shape[2] // stops.shape[1], axis=1)
    offsets = base_offset.astype(np.float32), offset.astype(np.float32)
    return HdrGainMap(codes, gains.astype(np.float32), *offsets, form)


def has_mark(path: Path) -> bool:
    """Whether a file mentions an HDR gain map."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return any(data.find(mark) >= 0 for mark in _MARKS)


def matching(gain_map: HdrGainMap, width: int, height: int) -> HdrGainMap:
    """A map resampled to its base picture.

    Raises:
        ValueError: its shape is another.
    """
    if not gain_map.fits(width, height):
        columns, rows = gain_map.codes.shape[1::-1]
        raise ValueError(
            f"it is {columns} x {rows}, another shape than the picture's {width} x {height}, "
            "as after a crop"
        )
    return gain_map.resized(width, height)


def left_out(why: str) -> str:
    """Note that a file's map was not applied."""
    return f"The file's {NAME} was not applied: {why}."


def applied(gain_map: HdrGainMap) -> str:
    """Note that a file's map was applied."""
    stops = math.log2(max(gain_map.headroom, 1.0))
    return f"The file's {NAME} ({gain_map.form}) was applied: {stops:.1f} stops above white."


def of_jpeg(data: bytes, exif: Mapping[int, Any]) -> HdrGainMap:
    """The gain map of a JPEG file: ISO's form if it has one, else Ultra HDR's, else Apple's.

    Args:
        data: the whole file.
        exif: its Exif IFD, for Apple's maker notes.

    Raises:
        ValueError: there is no map, or it cannot be used; the text says why.
    """
    failed = "it is missing"
    forms: list[tuple[int, HdrGainMap]] = []
    for begin, segments in _pictures_behind(data):
        xmp = b"".join(part[len(_XMP) :] for part in segments if part.startswith(_XMP))
        iso = next((part[len(_ISO) :] for part in segments if part.startswith(_ISO)), b"")
        try:
            numbers = None
            if len(iso) > 4:  # the version alone stands in the base picture
                rank, form, numbers = 0, "ISO 21496-1", _iso_numbers(iso)
            elif b"hdrgm:GainMapMax" in xmp or b"hdrgm:Version" in xmp:
                rank, form, numbers = 1, "Ultra HDR", _xmp_numbers(xmp)
            elif APPLE_GAIN_MAP.encode() not in xmp and b"HDRGainMapVersion" not in xmp:
                continue
            codes, profile = _decoded(data[begin:])
            if numbers is not None:
                forms.append((rank, _map_of(codes, numbers, form)))
            else:
                forms.append((2, apple(codes, profile, apple_headroom(exif, xmp))))
        except (ValueError, struct.error, IndexError, OSError) as error:
            failed = str(error) if isinstance(error, ValueError) else "it is damaged"
    if not forms:
        raise ValueError(failed)
    return min(forms, key=lambda form: form[0])[1]


def of_heic(path: Path, pixels: Pixels) -> HdrGainMap:
    """Apple's gain map of a HEIC, turned as the base is.

    Raises:
        ValueError: its headroom is missing, or it has more than 8 bits.
    """
    codes = pixels.gain_map
    if codes is None or codes.dtype != np.uint8:
        raise ValueError("it has more than 8 bits")
    # XMP of the auxiliary picture is stored as it is, and not handed out.
    headroom = apple_headroom(exif_ifd(pixels.info.get("exif") or b""), path.read_bytes())
    gain_map = apple(codes.reshape(*codes.shape[:2], -1), None, headroom)
    stored = np.rot90(codes.reshape(*codes.shape[:2], -1))
    turned = replace(gain_map, codes=np.ascontiguousarray(stored[..., :1]))
    size = pixels.size
    return gain_map if gain_map.fits(*size) or not turned.fits(*size) else turned


def apple(codes: NDArray[np.uint8], profile: bytes | None, headroom: float) -> HdrGainMap:
    """Apple's gain map of stored values (h, w, C), of which the first channel counts."""
    curve = ColorSpace("Rec.709", (rec709_decode,) * 3)
    linearise, _ = lineariser_of(profile, np.dtype(np.uint8), curve)
    every = np.arange(256, dtype=np.uint8)[:, None, None].repeat(3, axis=2)
    share = linearise(every)[:, 0, :1]
    none = np.zeros(1, np.float32)
    gains = np.asarray(1.0 + (headroom - 1.0) * share, np.float32)
    return HdrGainMap(np.ascontiguousarray(codes[..., :1]), gains, none, none, "Apple's")


def apple_headroom(exif: Mapping[int, Any], xmp: bytes) -> float:
    """Headroom of Apple's form: HDRGainMapHeadroom of XMP, else by maker notes 33 and 48.

    Raises:
        ValueError: neither is there.
    """
    stated = re.search(rb"HDRGainMapHeadroom\s*(?:=\s*[\"']|>)\s*([\d.]+)", xmp)
    if stated and 1.0 <= float(stated[1]) < 2.0**_MOST_STOPS:
        return float(stated[1])
    notes = _apple_notes(exif.get(Tag.MakerNote, b""))
    if not {_MAKER_HEADROOM, _MAKER_GAIN} <= notes.keys():
        raise ValueError("the headroom is missing, as in a picture that was edited")
    wide, gain = notes[_MAKER_HEADROOM] >= 1.0, notes[_MAKER_GAIN]
    if gain <= 0.01:
        stops = 3.0 - 70.0 * gain if wide else 1.8 - 20.0 * gain
    else:
        stops = 2.303 - 0.303 * gain if wide else 1.601 - 0.101 * gain
    return float(2.0 ** max(stops, 0.0))


def exif_ifd(exif: bytes) -> Mapping[int, Any]:
    """The Exif IFD of a block of Exif bytes by tag number; empty if it is damaged."""
    from PIL import Image

    tags = Image.Exif()
    try:
        tags.load(exif)
        return tags.get_ifd(Tag.ExifIFD)
    except Exception:  # the parser raises anything on damaged tags
        return {}


def _apple_notes(note: Any) -> dict[int, float]:  # noqa: ANN401
    """Signed rationals of Apple's maker note by tag; offsets count from its begin."""
    if not isinstance(note, bytes) or not note.startswith(b"Apple iOS\0"):
        return {}
    order = "<" if note[12:14] == b"II" else ">"
    values: dict[int, float] = {}
    try:
        (count,) = struct.unpack_from(f"{order}H", note, 14)
        for k in range(count):
            tag, kind, _, at = struct.unpack_from(f"{order}HHII", note, 16 + 12 * k)
            if kind == 10:
                over, under = struct.unpack_from(f"{order}2i", note, at)
                values[tag] = over / under
    except (struct.error, ZeroDivisionError):
        pass  # the tags behind are lost
    return values


def _pictures_behind(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Begin and application segments of the JPEGs behind the first.

    Compressed data has no start of one.
    """
    file, at = io.BytesIO(data), 0
    while (begin := data.find(_SOI, at)) >= 0:
        file.seek(begin)
        parts = [part for marker, part in jpeg_segments(file) if 0xE0 <= marker <= 0xEF]
        if at:
            yield begin, parts
        at = max(file.tell(), begin + 2)


def _decoded(data: bytes) -> tuple[NDArray[np.uint8], bytes | None]:
    """(h, w, 1 or 3) values of a JPEG, and its profile."""
    from PIL.JpegImagePlugin import JpegImageFile

    image = JpegImageFile(io.BytesIO(data))
    if image.size[0] * image.size[1] > 1 << 28:
        raise ValueError("it is too large")
    codes = np.asarray(image if image.mode in ("L", "RGB") else image.convert("RGB"))
    return codes.reshape(*codes.shape[:2], -1), image.info.get("icc_profile")


def _iso_numbers(block: bytes) -> _Numbers:
    """Metadata of ISO 21496-1, C.2: versions, flags, headrooms, five fractions a channel.

    Bytes behind them are allowed. libultrahdr's short form has one denominator for all.
    """
    least, _, flags = struct.unpack_from(">HHB", block)
    if least > 0:
        raise ValueError("its version is newer than ISO 21496-1:2025")
    channels = 3 if flags & _MULTICHANNEL else 1
    count = 2 + 5 * channels
    if flags & _COMMON_DENOMINATOR:
        under = np.full(count, struct.unpack_from(">I", block, 5)[0], np.float64)
        over = np.array(struct.unpack_from(">2I" + "iiIii" * channels, block, 9), np.float64)
    else:
        pairs = struct.unpack_from(">4I" + "iIiIIIiIiI" * channels, block, 5)
        over, under = np.array(pairs[::2], np.float64), np.array(pairs[1::2], np.float64)
    with np.errstate(all="ignore"):
        values = over / under
    if flags & _BACKWARD or not values[1] > values[0]:
        raise ValueError("its base is the brighter picture")
    return tuple(values[2:].reshape(channels, 5).T)


def _xmp_numbers(xmp: bytes) -> _Numbers:
    """Metadata in XMP, as attributes or elements, of one or three channels (Ultra HDR 1.1)."""
    base_is_hdr = re.search(rb"hdrgm:BaseRenditionIsHDR\s*(?:=\s*[\"']|>)\s*True", xmp, re.I)
    if base_is_hdr:
        raise ValueError("its base is the brighter picture")

    def stated(name: bytes, default: float | None) -> NDArray[np.float64]:
        match = re.search(rb"hdrgm:" + name + rb"\s*=\s*[\"']([^\"']*)[\"']", xmp)
        text = match[1] if match else b""
        if not match:
            match = re.search(rb"<hdrgm:" + name + rb"[^>]*>(.*?)</hdrgm:" + name, xmp, re.S)
            text = re.sub(rb"<[^>]*>", b" ", match[1]) if match else b""
        numbers = [float(word) for word in text.split()]
        if not numbers:
            if default is None:
                raise ValueError("its largest gain is missing")
            numbers = [default]
        return np.array(numbers, np.float64)

    parts = (
        stated(b"GainMapMin", 0.0),
        stated(b"GainMapMax", None),
        stated(b"Gamma", 1.0),
        stated(b"OffsetSDR", 1.0 / 64.0),
        stated(b"OffsetHDR", 1.0 / 64.0),
    )
    channels = 3 if max(len(part) for part in parts) > 1 else 1
    if any(len(part) not in (1, channels) for part in parts):
        raise ValueError("its numbers are damaged")
    return tuple(np.broadcast_to(part, (channels,)) for part in parts)
