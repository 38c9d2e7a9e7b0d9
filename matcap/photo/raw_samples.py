"""Samples of a DNG's raw picture as its tags define them: order, linearisation, levels, crop.

LibRaw gives black levels by place to the wrong colours where the active area begins at an odd row
or column, has a curve of its own for lossy JPEG, ignores interleaving, levels by row and plane and
MapPolynomial, and cannot read JPEG XL (of newer ProRAW). tifffile decompresses such files, and
LibRaw gets a plain DNG of them, normalised if it would misread the samples (DNG 1.7.1, chapter 5).
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.containers import Tag, check_pixels, decoding, missing_extra, unreadable
from matcap.photo.opcodes import ValueMap

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


def raw_page(file: Any) -> Any | None:  # noqa: ANN401
    """The largest raw picture of an open tifffile.TiffFile, or None."""
    pages = islice(_pages(file), _MOST_PAGES)
    raws = [page for page in pages if int(page.photometric) in (CFA, LINEAR_RAW)]
    return max(raws, key=lambda page: page.imagewidth * page.imagelength, default=None)


def _pages(file: Any) -> Iterator[Any]:  # noqa: ANN401
    for page in file.pages:
        yield page
        yield from page.pages or ()


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
        stated += [
            (code, _SHORT, planes, (level,) * planes, True) for code, level in levels.items()
        ]
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


def needs_normalising(page: Any, has_value_maps: bool) -> bool:  # noqa: ANN401
    """Whether LibRaw would misread the samples of a raw picture of whole numbers."""
    top, left, *_ = _whole(page.tags, Tag.ActiveArea, (0, 0))
    repeat = tuple(_whole(page.tags, Tag.BlackLevelRepeatDim, (1, 1)))
    black, white = (
        numbers(page.tags, Tag.BlackLevel, (0.0,)),
        numbers(page.tags, Tag.WhiteLevel, (65535.0,)),
    )
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


def unsupported_pattern(page: Any) -> str:  # noqa: ANN401
    """What a mosaic's pattern is, such as "4 x 4", if it is not supported; else ""."""
    size = tuple(_whole(page.tags, Tag.CFARepeatPatternDim, _PATTERNS[0]))
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
    across, down = (
        numbers(page.tags, tag, (0.0,)).astype(np.float32)
        for tag in (Tag.BlackLevelDeltaH, Tag.BlackLevelDeltaV)
    )
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


def crop_of(page: Any, tags: Mapping[int, Any]) -> Crop | None:  # noqa: ANN401
    """The crop that a DNG states; None where it is all of the active area, or is not inside.

    Args:
        tags: tags of the raw picture, and of the first page where it has none.
    """
    area = _whole(page.tags, Tag.ActiveArea, (0, 0, int(page.imagelength), int(page.imagewidth)))
    height, width = area[2] - area[0], area[3] - area[1]
    left, top = np.rint(_known(tags, Tag.DefaultCropOrigin, (0.0, 0.0))).astype(int).tolist()
    rest = (width - left, height - top)
    across, down = np.rint(_known(tags, Tag.DefaultCropSize, rest)).astype(int).tolist()
    if not (min(top, left) >= 0 and min(across, down) > 0):
        return None
    if top + down > height or left + across > width:
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


def numbers(tags: Any, tag: int, none: tuple[float, ...]) -> NDArray[np.float64]:  # noqa: ANN401
    """(n,) values of a tag among TIFF tags; quotients of rationals; `none` where it is absent."""
    entry = tags.get(tag)
    if entry is None:
        return np.array(none, np.float64)
    values = np.ravel(np.asarray(entry.value, np.float64))
    return values[0::2] / values[1::2] if int(entry.dtype) in _RATIONALS else values


def _known(tags: Any, tag: int, none: tuple[float, ...]) -> NDArray[np.float64]:  # noqa: ANN401
    """Values of a tag, or `none` where they are of another number, or not finite."""
    with np.errstate(all="ignore"):
        values = numbers(tags, tag, none)
    return values if values.size == len(none) and np.isfinite(values).all() else np.array(none)


def _whole(tags: Any, tag: int, none: tuple[int, ...]) -> list[int]:  # noqa: ANN401
    return [int(number) for number in numbers(tags, tag, none)]


def _factors(page: Any) -> tuple[int, int]:  # noqa: ANN401
    rows, columns = (
        max(_whole(page.tags, tag, (1,))[0], 1)
        for tag in (Tag.RowInterleaveFactor, Tag.ColumnInterleaveFactor)
    )
    return rows, columns
