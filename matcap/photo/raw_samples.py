"""Samples of a DNG's raw picture as its tags define them: order, linearisation, levels, crop.

LibRaw gives black levels by place to the wrong colours where the active area begins at an odd row
or column, has a curve of its own for lossy JPEG, ignores interleaving, levels by row and plane and
MapPolynomial, and cannot read JPEG XL (of newer ProRAW). tifffile decompresses such files, and
LibRaw gets a plain DNG of them, normalised if it would misread the samples (DNG 1.7.1, chapter 5).
"""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.containers import Tag, check_pixels, decoding, missing_extra, unreadable

# tifffile's, which has no types.
TiffFile = Any
TiffPage = Any
Tags = Mapping[int, Any]  # of TIFF, by number
CFA, LINEAR_RAW = 32803, 34892  # photometric interpretations (DNG 1.7)
JPEG_XL, _LOSSY_JPEG, _NONE = 52546, 34892, 1  # compressions
FLOATING = 3  # a SampleFormat
# Tags that are done once the samples are normalised.
_DONE = {
    *(Tag.LinearizationTable, Tag.BlackLevelRepeatDim, Tag.BlackLevel, Tag.WhiteLevel),
    *(Tag.BlackLevelDeltaH, Tag.BlackLevelDeltaV, Tag.ActiveArea, Tag.MaskedAreas),
    *(Tag.RowInterleaveFactor, Tag.ColumnInterleaveFactor),
    *(Tag.DefaultCropOrigin, Tag.DefaultCropSize, Tag.DefaultUserCrop),
    *(Tag.OpcodeList1, Tag.OpcodeList2, Tag.OpcodeList3),
}
# Tags of a plain DNG, beside those from DNGVersion on: maker, model, mosaic.
_KEPT = (271, 272, Tag.Orientation, Tag.CFARepeatPatternDim, Tag.CFAPattern)
_RATIONALS = (5, 10)  # types of TIFF
_SHORT = 3
# Black and white of normalised mosaics, so that noise below black is kept.
_PEDESTAL, _WHITE = 4096, 65535
_MOST_PAGES = 64  # a damaged file may claim any number of them
# Differences of black levels, over the range of light, that matter: where LibRaw gives them to the
# wrong colours, and where it scales by the least of them.
_LEAST_SPREAD, _SPREAD = 1e-3, 1e-2
_LARGEST_PATTERN = 64  # photosites a side, of black levels; a damaged file may claim any
_PATTERNS = ((2, 2), (6, 6))  # of mosaics: Bayer, X-Trans


def raw_page(file: TiffFile) -> TiffPage | None:
    """The largest raw picture of an open tifffile.TiffFile, or None."""
    pages = chain.from_iterable(chain((page,), page.pages or ()) for page in file.pages)
    raws = [p for p in islice(pages, _MOST_PAGES) if int(p.photometric) in (CFA, LINEAR_RAW)]
    return max(raws, key=lambda page: page.imagewidth * page.imagelength, default=None)


def plain_dng(path: Path, maps: tuple[ValueMap, ...] | None) -> bytes:
    """A DNG as an uncompressed one, of its raw picture alone.

    Args:
        maps: to normalise the samples with, by none or more; None keeps them as they are stored.

    Raises:
        MatcapError: truncated, damaged, without a raw picture of integers in one or three samples,
            or imagecodecs, an extra, is not installed.
    """
    import tifffile

    with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
        page = raw_page(file)
        if page is None:
            raise unreadable(path, "DNG")
        check_pixels(path, page.imagewidth, page.imagelength)
        if int(page.compression) != _NONE:
            check_codecs(path)
        tags = {tag.code: tag for one in (page, file.pages.first) for tag in one.tags}
        tags |= {tag.code: tag for tag in page.tags if tag.code != Tag.Orientation}
        kept = {code for code in tags if code in _KEPT or code >= Tag.DNGVersion}
        samples, levels = page.asarray(), {}
        if maps is not None:
            light, kept = normalised(page, maps), kept - _DONE
            levels = {Tag.BlackLevel: _PEDESTAL if light.ndim == 2 else 0, Tag.WhiteLevel: _WHITE}
            span = _WHITE - levels[Tag.BlackLevel]
            samples = np.clip(np.rint(levels[Tag.BlackLevel] + light * span), 0, _WHITE)
            samples = samples.astype(np.uint16)
        elif Tag.WhiteLevel not in kept:
            levels = {Tag.WhiteLevel: 2 ** int(page.bitspersample) - 1}
        if samples.dtype.kind != "u" or samples.shape[2:] not in ((), (3,)):
            raise MatcapError.at(
                path,
                "the DNG holds neither a mosaic nor linear colours of whole numbers",
                "convert it with Adobe DNG Converter, without JPEG XL",
            )
        planes = samples[..., None].shape[2]
        stated = [(c, int(tags[c].dtype), tags[c].count, tags[c].value, True) for c in sorted(kept)]
        stated += [(c, _SHORT, planes, (level,) * planes, True) for c, level in levels.items()]
        plain = io.BytesIO()
        tifffile.imwrite(
            plain,
            samples.astype(np.uint16),
            photometric=CFA if planes == 1 else LINEAR_RAW,
            planarconfig=None if planes == 1 else "contig",
            metadata=None,
            software=False,
            extratags=stated,
        )
        return plain.getvalue()


def check_codecs(path: Path) -> None:
    """Raise MatcapError if imagecodecs is not installed, by which tifffile decompresses."""
    try:
        import imagecodecs  # noqa: F401
    except ImportError as error:
        form = "a DNG in floating point, or compressed with JPEG XL or lossy JPEG,"
        raise missing_extra(path, form, "jxl") from error


def needs_normalising(page: TiffPage, has_value_maps: bool) -> bool:
    """Whether LibRaw would misread the samples of a raw picture of whole numbers."""
    top, left, *_ = _whole(page.tags, Tag.ActiveArea, (0, 0))
    repeat = tuple(_whole(page.tags, Tag.BlackLevelRepeatDim, (1, 1)))
    black = numbers(page.tags, Tag.BlackLevel, (0.0,))
    white = numbers(page.tags, Tag.WhiteLevel, (65535.0,))
    spread = float(np.ptp(black)) / max(float(white.min() - black.max()), 1.0)
    odd = (top | left) % 2 == 1 or int(page.samplesperpixel) > 1
    return bool(
        has_value_maps
        or int(page.compression) == _LOSSY_JPEG
        or _factors(page) != (1, 1)
        or numbers(page.tags, Tag.BlackLevelDeltaH, (0.0,)).any()
        or numbers(page.tags, Tag.BlackLevelDeltaV, (0.0,)).any()
        or repeat not in ((1, 1), (2, 2))
        or spread > (_LEAST_SPREAD if odd else _SPREAD)
        or len(set(white)) > 1
    )


def unsupported_pattern(page: TiffPage) -> str:
    """What a mosaic's pattern is, such as "4 x 4", if it is not supported; else ""."""
    size = tuple(_whole(page.tags, Tag.CFARepeatPatternDim, _PATTERNS[0]))
    return "" if size in _PATTERNS else " x ".join(map(str, size))


def normalised(page: TiffPage, maps: tuple[ValueMap, ...] = ()) -> NDArray[np.float32]:
    """(H, W) or (H, W, C) samples of the active area; black is 0, white 1 (DNG 1.7.1, chapter 5).

    Raises:
        Exception: of any kind where the file is damaged.
    """
    stored = in_order(page.asarray(), *_factors(page))
    if Tag.LinearizationTable in page.tags:
        table = np.asarray(page.tags[Tag.LinearizationTable].value, np.float32)
        stored = table[np.minimum(stored, len(table) - 1)]
    samples: Any = stored.astype(np.float32)
    area = _whole(page.tags, Tag.ActiveArea, (0, 0, *samples.shape[:2]))
    samples = samples[area[0] : area[2], area[1] : area[3]]
    flat = samples.ndim == 2
    samples = samples[..., None] if flat else samples
    height, width, planes = samples.shape
    rows, columns = _whole(page.tags, Tag.BlackLevelRepeatDim, (1, 1))
    if not (1 <= rows <= _LARGEST_PATTERN and 1 <= columns <= _LARGEST_PATTERN):
        raise ValueError("a pattern of black levels that no sensor has")
    pattern = np.resize(numbers(page.tags, Tag.BlackLevel, (0.0,)), rows * columns * planes)
    pattern = pattern.reshape(rows, columns, planes).astype(np.float32)
    black = pattern[np.arange(height)[:, None] % rows, np.arange(width)[None] % columns]
    across = numbers(page.tags, Tag.BlackLevelDeltaH, (0.0,)).astype(np.float32)
    down = numbers(page.tags, Tag.BlackLevelDeltaV, (0.0,)).astype(np.float32)
    if len(across) not in (1, width) or len(down) not in (1, height):
        raise ValueError("black levels by row or column that do not fit")
    black = black + across[None, :, None] + down[:, None, None]
    floating = int(page.sampleformat) == FLOATING
    full = 1.0 if floating else float(2 ** int(page.bitspersample) - 1)
    white = np.resize(numbers(page.tags, Tag.WhiteLevel, (full,)), planes)
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


def centre_colours(mosaic: NDArray[Any], colours: NDArray[np.integer]) -> None:
    """Red and blue of a mosaic (H, W) interpolated, in place, at the middle of 2 x 2 photosites.

    They lie a quarter of their spacing from it, on opposite sides; the mean of both greens lies on
    it. Left there, the slope of luminance would be false colour.

    Args:
        colours: (2, 2) of the photosites: 0 is red, 2 is blue.
    """
    for row, column in np.argwhere((colours == 0) | (colours == 2)):
        # The photosite before, its own and the one after.
        down, across = (np.array([0.25 * at, 0.75, 0.25 - 0.25 * at]) for at in (row, column))
        sites = mosaic[row::2, column::2]
        middle = cv2.sepFilter2D(
            sites.astype(np.float32), cv2.CV_32F, across, down, borderType=cv2.BORDER_REPLICATE
        )
        sites[...] = middle if mosaic.dtype.kind == "f" else np.rint(middle)


@dataclass(frozen=True)
class Crop:
    """The part of the active area that is the picture."""

    whole: tuple[int, int, int, int]
    """DefaultCrop: top, left, bottom, right; Exif's focal lengths refer to it."""
    shown: tuple[int, int, int, int]
    """Of it, the smallest part around its centre that holds DefaultUserCrop."""
    centred: bool
    """Whether that is DefaultUserCrop itself."""

    @property
    def sizes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """(width, height) of `shown` and of `whole`."""
        shown, whole = (
            (right - left, bottom - top) for top, left, bottom, right in (self.shown, self.whole)
        )
        return shown, whole


def crop_of(page: TiffPage, tags: Tags) -> Crop | None:
    """The crop that a DNG states; None where it is all of the active area, or is not inside.

    Args:
        tags: tags of the raw picture, and of the first page where it has none.
    """
    area = _whole(page.tags, Tag.ActiveArea, (0, 0, int(page.imagelength), int(page.imagewidth)))
    height, width = area[2] - area[0], area[3] - area[1]
    left, top = np.rint(_known(tags, Tag.DefaultCropOrigin, (0.0, 0.0))).astype(int).tolist()
    rest = (width - left, height - top)
    across, down = np.rint(_known(tags, Tag.DefaultCropSize, rest)).astype(int).tolist()
    fits = top + down <= height and left + across <= width
    if not (fits and min(top, left) >= 0 and min(across, down) > 0):
        return None
    edges = _known(tags, Tag.DefaultUserCrop, (0.0, 0.0, 1.0, 1.0))
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


def numbers(tags: Tags, tag: int, none: tuple[float, ...]) -> NDArray[np.float64]:
    """(n,) values of a tag among TIFF tags; quotients of rationals; `none` where it is absent."""
    entry = tags.get(tag)
    if entry is None:
        return np.array(none, np.float64)
    values = np.ravel(np.asarray(entry.value, np.float64))
    return values[0::2] / values[1::2] if int(entry.dtype) in _RATIONALS else values


def _known(tags: Tags, tag: int, none: tuple[float, ...]) -> NDArray[np.float64]:
    """Values of a tag, or `none` where they are of another number, or not finite."""
    values = finite_numbers(tags, tag, len(none))
    return np.array(none) if values is None else values


def finite_numbers(tags: Tags, tag: int, count: int) -> NDArray[np.float64] | None:
    """So many numbers of a tag; None if it is absent, has others, or a rational over 0."""
    with np.errstate(all="ignore"):
        values = numbers(tags, tag, ())
    return values if len(values) == count and np.isfinite(values).all() else None


def _whole(tags: Tags, tag: int, none: tuple[int, ...]) -> list[int]:
    return [int(number) for number in numbers(tags, tag, none)]


def _factors(page: TiffPage) -> tuple[int, int]:
    tags = page.tags
    rows = max(_whole(tags, Tag.RowInterleaveFactor, (1,))[0], 1)
    return rows, max(_whole(tags, Tag.ColumnInterleaveFactor, (1,))[0], 1)


# Opcodes of a DNG's raw picture: GainMap, which is lens shading, MapTable and MapPolynomial.
#
# Adobe DNG 1.7.1, chapter 7. raw.py applies gain maps, normalised() maps of values. Other opcodes
# are not applied; those that change more than single bad pixels give a note.

_MAP_TABLE, _MAP_POLYNOMIAL, _GAIN_MAP = 7, 8, 9
_VALUE_MAPS = (_MAP_TABLE, _MAP_POLYNOMIAL)
VALUE_MAPPING = "a correction of values"
# Opcodes that change radiance or position, as text for notes; a GainMap is always applied.
_CHANGES = {
    **dict.fromkeys((1, 2, 14), "a lens distortion correction"),
    3: "a radial vignette correction",
    **dict.fromkeys(_VALUE_MAPS, VALUE_MAPPING),
    **dict.fromkeys((10, 11, 12, 13), "a correction of rows or columns"),
}
_HEADER = struct.Struct(">4I 4I 2I 4d I")  # of a GainMap
_AREA = struct.Struct(">8I I")  # area, plane, planes, pitch; then the number of entries or degree
_HIGHEST_DEGREE = 8  # of a MapPolynomial
_MOST_POINTS = 1 << 24  # of a GainMap; limits the memory that a file can claim


@dataclass(frozen=True)
class GainMap:
    """Gains on a coarse grid over the active area."""

    area: tuple[int, int, int, int]
    """Top, left, bottom, right of the pixels it applies to; the last two excluded."""
    planes: tuple[int, int]
    """First plane it applies to, and the plane after the last."""
    pitch: tuple[int, int]
    """Applies to every pitch-th row and column of the area."""
    spacing: tuple[float, float]
    origin: tuple[float, float]
    """Spacing and origin of the grid (vertical, horizontal), in sides of the active area."""
    gains: NDArray[np.float32]
    """(V, H, P) float32; planes beyond P use the last."""

    def at(
        self, rows: NDArray[np.float64], columns: NDArray[np.float64], plane: int
    ) -> NDArray[np.float32]:
        """(R, C) bilinear gains at relative positions in [0, 1], clamped to the grid."""
        grid = self.gains[..., min(plane - self.planes[0], self.gains.shape[2] - 1)]
        down = _weights(rows, self.gains.shape[0], self.spacing[0], self.origin[0])
        across = _weights(columns, self.gains.shape[1], self.spacing[1], self.origin[1])
        return np.asarray(down @ grid @ across.T, np.float32)


@dataclass(frozen=True)
class Shading:
    """All gain maps of one opcode list, for a picture that shows a part of the active area."""

    maps: tuple[GainMap, ...]
    """Gain maps, in coordinates of the active area."""
    active: tuple[int, int]
    """(height, width) of the active area."""
    size: tuple[int, int]
    """(height, width) of the picture."""
    offset: tuple[int, int] = (0, 0)
    """(row, column) of the picture's first pixel in the active area."""

    def gains(self, top: int, bottom: int, planes: int) -> NDArray[np.float32]:
        """(n, W, planes) gains for the picture's rows [top, bottom)."""
        total = np.ones((bottom - top, self.size[1], planes), np.float32)
        for gain_map in self.maps:
            rows, down = self._touched(gain_map, np.arange(top, bottom), 0)
            columns, across = self._touched(gain_map, np.arange(self.size[1]), 1)
            place = np.ix_(rows, columns)
            for plane in range(gain_map.planes[0], min(gain_map.planes[1], planes)):
                total[..., plane][place] *= gain_map.at(down, across, plane)
        return total

    def largest(self, planes: int) -> float:
        """The largest gain, at least 1."""
        step = 256
        strips = ((top, min(top + step, self.size[0])) for top in range(0, self.size[0], step))
        return max(1.0, *(float(self.gains(*strip, planes).max()) for strip in strips))

    def _touched(
        self, gain_map: GainMap, pixels: NDArray[np.intp], axis: int
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Mask of rows (axis 0) or columns that a map applies to, and their relative positions."""
        first, last = gain_map.area[axis], gain_map.area[axis + 2]
        sites = pixels + self.offset[axis]
        on_pitch = (sites - first) % gain_map.pitch[axis] == 0
        inside = (sites >= first) & (sites < last) & on_pitch
        return inside, (sites[inside] + 0.5) / self.active[axis]


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


@dataclass(frozen=True)
class Opcodes:
    """The opcodes of a list, in order."""

    gain_maps: tuple[GainMap, ...] = ()
    """Lens shading."""
    value_maps: tuple[ValueMap, ...] = ()
    """MapTable and MapPolynomial."""
    changes: frozenset[str] = frozenset()
    """Names of all other corrections, and VALUE_MAPPING."""


def parse_opcodes(data: bytes) -> Opcodes:
    """Parse an OpcodeList.

    Raises:
        ValueError: the bytes are not an opcode list.
    """
    gain_maps, value_maps, changes, offset = [], [], set(), 4
    try:
        (count,) = struct.unpack_from(">I", data)
        for _ in range(count):
            opcode, _version, _flags, size = struct.unpack_from(">4I", data, offset)
            payload = data[offset + 16 : offset + 16 + size]
            if opcode == _GAIN_MAP:
                gain_maps.append(_gain_map(payload))
            if opcode in _VALUE_MAPS:
                value_maps.append(_value_map(opcode, payload))
            if opcode in _CHANGES:
                changes.add(_CHANGES[opcode])
            offset += 16 + size
    except struct.error as error:
        raise ValueError("the opcode list is cut short") from error
    return Opcodes(tuple(gain_maps), tuple(value_maps), frozenset(changes))


def _gain_map(payload: bytes) -> GainMap:
    numbers = _HEADER.unpack_from(payload)
    area, (plane, planes, *pitch) = numbers[:4], numbers[4:8]
    points, spacing, origin, depth = numbers[8:10], numbers[10:12], numbers[12:14], numbers[14]
    count = points[0] * points[1] * depth
    if not 0 < count <= _MOST_POINTS or len(payload) < _HEADER.size + 4 * count:
        raise ValueError("a gain map is cut short")
    gains = np.frombuffer(payload, ">f4", count, _HEADER.size).astype(np.float32)
    if min(pitch) < 1 or not (np.isfinite(gains).all() and gains.min() > 0.0):
        raise ValueError("a gain map has invalid numbers")
    if not all(np.isfinite(spacing)) or not all(np.isfinite(origin)):
        raise ValueError("a gain map has an invalid grid")
    return GainMap(
        area,
        (plane, plane + planes),
        (pitch[0], pitch[1]),
        spacing,
        origin,
        gains.reshape(*points, depth),
    )


def _weights(
    positions: NDArray[np.float64], points: int, spacing: float, origin: float
) -> NDArray[np.float32]:
    """(positions, points) matrix of linear interpolation, clamped at the ends."""
    if points == 1 or spacing <= 0.0:
        weights = np.zeros((positions.size, points), np.float32)
        weights[:, 0] = 1.0
        return weights
    place = np.clip((positions - origin) / spacing, 0.0, points - 1.0)
    distance = np.abs(place[:, None] - np.arange(points))
    return np.maximum(1.0 - distance, 0.0).astype(np.float32)


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
