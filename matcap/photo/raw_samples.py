"""Samples of a DNG's raw picture as its tags define them: order, linearisation, levels (DNG 1.7.1).

LibRaw gives black levels by place to the wrong colours where the active area begins at an odd row
or column, has a curve of its own for lossy JPEG, and ignores interleaving, levels by row and plane
and MapPolynomial. load.py rewrites such files by this module.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.files.containers import Tag

JPEG_XL, _LOSSY_JPEG = 52546, 34892  # compressions
# Tags that are done once the samples are normalised.
DONE = (
    *(
        Tag.LinearizationTable,
        Tag.BlackLevelRepeatDim,
        Tag.BlackLevel,
        Tag.BlackLevelDeltaH,
        Tag.BlackLevelDeltaV,
        Tag.WhiteLevel,
    ),
    *(Tag.ActiveArea, Tag.MaskedAreas, Tag.RowInterleaveFactor, Tag.ColumnInterleaveFactor),
    *(Tag.DefaultCropOrigin, Tag.DefaultCropSize, Tag.DefaultUserCrop),
    *(Tag.OpcodeList1, Tag.OpcodeList2, Tag.OpcodeList3),
)
_RATIONALS, _FLOATING = (5, 10), 3  # types of TIFF, and a SampleFormat
_MAP_TABLE, _MAP_POLYNOMIAL = 7, 8  # opcodes
VALUE_MAPS = (_MAP_TABLE, _MAP_POLYNOMIAL)
_AREA = struct.Struct(">8I I")  # area, plane, planes, pitch; then the number of entries or degree
_HIGHEST_DEGREE = 8  # of a MapPolynomial
# Differences of black levels, over the range of light, that matter: where LibRaw gives them to the
# wrong colours, and where it scales by the least of them.
_LEAST_SPREAD, _SPREAD = 1e-3, 1e-2
_LARGEST_PATTERN = 64  # photosites a side, of black levels; a damaged file may claim any
_PATTERNS = ((2, 2), (6, 6))  # of mosaics: Bayer, X-Trans


def needs_normalising(page: Any, has_value_maps: bool) -> bool:  # noqa: ANN401
    """Whether LibRaw would misread the samples of a raw picture of whole numbers."""
    top, left, *_ = _whole(page, Tag.ActiveArea, (0, 0))
    repeat = tuple(_whole(page, Tag.BlackLevelRepeatDim, (1, 1)))
    black, white = value(page, Tag.BlackLevel, (0.0,)), value(page, Tag.WhiteLevel, (65535.0,))
    spread = float(np.ptp(black)) / max(float(white.min() - black.max()), 1.0)
    odd = (top | left) % 2 == 1 or int(page.samplesperpixel) > 1
    return bool(
        has_value_maps
        or int(page.compression) == _LOSSY_JPEG
        or _factors(page) != (1, 1)
        or value(page, Tag.BlackLevelDeltaH, (0.0,)).any()
        or value(page, Tag.BlackLevelDeltaV, (0.0,)).any()
        or repeat not in ((1, 1), (2, 2))
        or spread > (_LEAST_SPREAD if odd else _SPREAD)
        or len(set(white)) > 1
    )


def unsupported_pattern(page: Any) -> str:  # noqa: ANN401
    """What a mosaic's pattern is, such as "4 x 4", if it is not supported; else ""."""
    size = tuple(_whole(page, Tag.CFARepeatPatternDim, _PATTERNS[0]))
    return "" if size in _PATTERNS else " x ".join(map(str, size))


def normalised(page: Any, maps: tuple[ValueMap, ...] = ()) -> NDArray[np.float32]:  # noqa: ANN401
    """(H, W) or (H, W, C) samples of the active area; black is 0, white 1 (DNG 1.7.1, chapter 5).

    Raises:
        Exception: of any kind where the file is damaged.
    """
    stored = in_order(page.asarray(), *_factors(page))
    if Tag.LinearizationTable in page.tags:
        table = np.asarray(page.tags[Tag.LinearizationTable].value, np.float32)
        stored = table[np.minimum(stored, len(table) - 1)]
    samples: Any = stored.astype(np.float32)
    area = _whole(page, Tag.ActiveArea, (0, 0, *samples.shape[:2]))
    samples = samples[area[0] : area[2], area[1] : area[3]]
    flat = samples.ndim == 2
    samples = samples[..., None] if flat else samples
    height, width, planes = samples.shape
    rows, columns = _whole(page, Tag.BlackLevelRepeatDim, (1, 1))
    if not (1 <= rows <= _LARGEST_PATTERN and 1 <= columns <= _LARGEST_PATTERN):
        raise ValueError("a pattern of black levels that no sensor has")
    pattern = np.resize(value(page, Tag.BlackLevel, (0.0,)), rows * columns * planes)
    pattern = pattern.reshape(rows, columns, planes).astype(np.float32)
    black = pattern[np.arange(height)[:, None] % rows, np.arange(width)[None] % columns]
    across, down = (
        value(page, tag, (0.0,)).astype(np.float32)
        for tag in (Tag.BlackLevelDeltaH, Tag.BlackLevelDeltaV)
    )
    if len(across) not in (1, width) or len(down) not in (1, height):
        raise ValueError("black levels by row or column that do not fit")
    black = black + across[None, :, None] + down[:, None, None]
    floating = int(page.sampleformat) == _FLOATING
    full = 1.0 if floating else float(2 ** int(page.bitspersample) - 1)
    white = np.resize(value(page, Tag.WhiteLevel, (full,)), planes)
    span = white - black.max(axis=(0, 1))
    if not (np.isfinite(span).all() and span.min() > 0.0):
        raise ValueError("white is not above black")
    samples = (samples - black) / span.astype(np.float32)
    for one in maps:
        one.apply(samples)
    return np.asarray(samples[..., 0] if flat else samples)


def in_order(stored: NDArray[Any], rows: int, columns: int) -> NDArray[Any]:
    """Samples in order, of which every n-th row and every n-th column are stored together."""
    for axis, factor in ((0, rows), (1, columns)):
        if factor > 1:
            size = stored.shape[axis]
            places = np.concatenate([np.arange(first, size, factor) for first in range(factor)])
            stored = np.take(stored, np.argsort(places), axis=axis)
    return stored


@dataclass(frozen=True)
class ValueMap:
    """A MapTable or MapPolynomial opcode (DNG 1.7.1, chapter 7)."""

    area: tuple[int, int, int, int]
    """Top, left, bottom, right; the last two excluded."""
    planes: tuple[int, int]
    """First plane, and number of planes."""
    pitch: tuple[int, int]
    """Rows and columns between the samples that it applies to."""
    numbers: NDArray[np.float64]
    """Values in [0, 1] of a table, or coefficients of a polynomial."""
    is_table: bool
    """Whether it is a table."""

    def apply(self, samples: NDArray[np.float32]) -> None:
        """Map normalised samples (H, W, C) in place, clipped to [0, 1]."""
        top, left, bottom, right = self.area
        first, count = self.planes
        down, across = self.pitch
        place = np.s_[top:bottom:down, left:right:across, first : first + count]
        inside = np.clip(samples[place], 0.0, 1.0).astype(np.float64)
        if self.is_table:
            last = len(self.numbers) - 1
            mapped: Any = np.interp(inside * 65535.0, np.arange(last + 1), self.numbers)
        else:
            mapped = np.polynomial.polynomial.polyval(inside, self.numbers)
        samples[place] = np.clip(mapped, 0.0, 1.0)


def value_maps(data: bytes) -> tuple[ValueMap, ...]:
    """The MapTable and MapPolynomial opcodes of an OpcodeList, in order.

    Raises:
        ValueError: the bytes are not an opcode list.
    """
    try:
        (count,) = struct.unpack_from(">I", data)
        maps, offset = [], 4
        for _ in range(count):
            opcode, _version, _flags, size = struct.unpack_from(">4I", data, offset)
            if opcode in VALUE_MAPS:
                maps.append(_value_map(opcode, data[offset + 16 : offset + 16 + size]))
            offset += 16 + size
    except struct.error as error:
        raise ValueError("the opcode list is cut short") from error
    return tuple(maps)


def _value_map(opcode: int, payload: bytes) -> ValueMap:
    *head, count = _AREA.unpack_from(payload)
    is_table = opcode == _MAP_TABLE
    if not is_table and count > _HIGHEST_DEGREE:
        raise ValueError("a polynomial of too high a degree")
    entries = count if is_table else count + 1
    kind = ">u2" if is_table else ">f8"
    if len(payload) < _AREA.size + entries * np.dtype(kind).itemsize or entries < 1:
        raise ValueError("a map of values is cut short")
    numbers = np.frombuffer(payload, kind, entries, _AREA.size).astype(np.float64)
    if not np.isfinite(numbers).all() or min(head[6:8]) < 1:
        raise ValueError("a map of values has invalid numbers")
    area = (head[0], head[1], head[2], head[3])
    return ValueMap(
        area,
        (head[4], head[5]),
        (head[6], head[7]),
        numbers / 65535.0 if is_table else numbers,
        is_table,
    )


@dataclass(frozen=True)
class Crop:
    """The part of the active area that is the picture."""

    whole: tuple[int, int, int, int]
    """DefaultCrop: top, left, bottom, right; Exif's focal lengths refer to it."""
    shown: tuple[int, int, int, int]
    """Of it, the smallest part around its centre that holds DefaultUserCrop."""
    centred: bool
    """Whether that is DefaultUserCrop itself."""


def crop_of(page: Any, tags: Mapping[int, Any]) -> Crop | None:  # noqa: ANN401
    """The crop that a DNG states; None where it is all of the active area, or is not inside.

    Args:
        tags: tags of the raw picture, and of the first page where it has none.
    """
    area = _whole(page, Tag.ActiveArea, (0, 0, int(page.imagelength), int(page.imagewidth)))
    height, width = area[2] - area[0], area[3] - area[1]
    left, top = (
        round(float(edge)) for edge in _numbers(tags.get(Tag.DefaultCropOrigin), (0.0, 0.0))
    )
    across, down = (
        round(float(side))
        for side in _numbers(tags.get(Tag.DefaultCropSize), (width - left, height - top))
    )
    if not (min(top, left) >= 0 and min(across, down) > 0):
        return None
    if top + down > height or left + across > width:
        return None
    edges = _numbers(tags.get(Tag.DefaultUserCrop), (0.0, 0.0, 1.0, 1.0))
    if not 0.0 <= edges[0] < edges[2] <= 1.0 or not 0.0 <= edges[1] < edges[3] <= 1.0:
        edges = np.array((0.0, 0.0, 1.0, 1.0))
    tall, wide = (max(0.5 - edges[i], edges[i + 2] - 0.5) for i in (0, 1))
    inset = round((0.5 - tall) * down), round((0.5 - wide) * across)
    whole = (top, left, top + down, left + across)
    shown = (top + inset[0], left + inset[1], whole[2] - inset[0], whole[3] - inset[1])
    if shown == (0, 0, height, width):
        return None
    off = max(abs(edges[0] + edges[2] - 1.0), abs(edges[1] + edges[3] - 1.0))
    return Crop(whole, shown, bool(off < 1e-3))


def value(page: Any, tag: int, none: tuple[float, ...]) -> NDArray[np.float64]:  # noqa: ANN401
    """(n,) values of a tag of a page; quotients of rationals."""
    if tag not in page.tags:
        return np.array(none, np.float64)
    entry = page.tags[tag]
    numbers = np.ravel(np.asarray(entry.value, np.float64))
    if int(entry.dtype) in _RATIONALS:
        numbers = numbers[0::2] / numbers[1::2]
    return numbers


def _numbers(entry: Any, none: tuple[float, ...]) -> NDArray[np.float64]:  # noqa: ANN401
    """(n,) values of a TIFF tag, or `none` where it is absent or of another length."""
    if entry is None:
        return np.array(none)
    numbers = np.ravel(np.asarray(entry.value, np.float64))
    if int(entry.dtype) in _RATIONALS and numbers.size % 2 == 0 and numbers[1::2].all():
        numbers = numbers[0::2] / numbers[1::2]
    fits = numbers.size == len(none) and np.isfinite(numbers).all()
    return numbers if fits else np.array(none)


def _whole(page: Any, tag: int, none: tuple[int, ...]) -> list[int]:  # noqa: ANN401
    return [int(number) for number in value(page, tag, none)]


def _factors(page: Any) -> tuple[int, int]:  # noqa: ANN401
    rows, columns = (
        max(_whole(page, tag, (1,))[0], 1)
        for tag in (Tag.RowInterleaveFactor, Tag.ColumnInterleaveFactor)
    )
    return rows, columns
