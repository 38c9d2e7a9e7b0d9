"""DNGs compressed with JPEG XL (newer ProRAW): read by tifffile and developed here.

LibRaw cannot open them. The arithmetic is LibRaw's, on the same tags, so that a picture comes out
as it would have from the same DNG uncompressed: black and white level, lens shading, AsShotNeutral,
ColorMatrix. CFA pictures are demosaiced bilinearly. Left out: opcodes other than gain maps,
white level by channel, calibration matrices and profiles.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.photo.decoded import Decoded
from matcap.photo.dng import Corrections, raw_page
from matcap.photo.gainmap import Shading
from matcap.photo.raw import CLIP_SHARE
from matcap.photo.refusals import check_size, decoding, missing_extra, unreadable
from matcap.photo.shrink import ReadRows, Rows, shrink

_LINEARIZATION, _BLACK, _BLACK_REPEAT, _WHITE = 50712, 50714, 50713, 50717
_COLOR_MATRICES, _ILLUMINANTS, _NEUTRAL, _CFA_PATTERN = (50721, 50722), (50778, 50779), 50728, 33422
_D65 = 21  # a calibration illuminant (Exif's LightSource)
_BAYER = ([0, 1, 1, 2], [2, 1, 1, 0], [1, 0, 2, 1], [1, 2, 0, 1])
_FULL = 65535.0  # code values

# Linear Rec.709 to XYZ relative to D65 (IEC 61966-2-1), as DNG colour matrices start from XYZ.
_REC709_TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


@dataclass(frozen=True)
class MosaicLevels:
    """How stored numbers become camera colours.

    Attributes:
        black: (r, c, S) black levels, repeating over the picture; S is 1 or 3 samples.
        white: the level at which samples saturate.
        lift: (3,) white-balance factors, the smallest 1.
        to_rec709: (3, 3) from balanced camera colours; its rows add up to 1.
        pattern: (2, 2) colour of each photosite, or None where every pixel has all three.
        table: linearisation of stored numbers, or None.
    """

    black: NDArray[np.float64]
    white: float
    lift: NDArray[np.float64]
    to_rec709: NDArray[np.float64]
    pattern: NDArray[np.intp] | None
    table: NDArray[np.float64] | None


def read_jxl(path: Path, long_side: int | None, corrections: Corrections) -> Decoded:
    """Read a JPEG-XL DNG through tifffile and imagecodecs, an extra.

    Raises:
        MatcapError: imagecodecs is not installed, or the file is truncated or damaged.
    """
    try:
        import imagecodecs  # noqa: F401  (tifffile calls it)
    except ImportError as error:
        raise missing_extra(path, "a DNG compressed with JPEG XL", "jxl") from error
    return read_with_tifffile(path, long_side, corrections)


def read_with_tifffile(path: Path, long_side: int | None, corrections: Corrections) -> Decoded:
    """Develop any DNG whose compression tifffile can undo; see `read_jxl`.

    Raises:
        MatcapError: truncated, damaged, too small, or of a form that is not supported.
    """
    import tifffile

    with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
        page = raw_page(file)
        if page is None:
            raise unreadable(path, "DNG")
        check_size(path, page.imagewidth, page.imagelength)
        samples = page.asarray()
        sensor = _sensor(page, 1 if samples.ndim == 2 else samples.shape[2])
        orientation = int(_numbers(file.pages[0], 274, (1,))[0])
    planes = 1 if sensor.pattern is not None else 3
    if samples.dtype.kind != "u" or samples.shape[2:] != (() if planes == 1 else (3,)):
        raise MatcapError(
            "the DNG holds neither a mosaic nor linear colours of whole numbers",
            where=str(path),
            remedy="convert it with Adobe DNG Converter, without JPEG XL",
        )
    top, left, bottom, right = corrections.active_area or (0, 0, *samples.shape[:2])
    samples = samples[top:bottom, left:right]
    check_size(path, samples.shape[1], samples.shape[0])
    pixels, clipped = develop(samples, sensor, corrections, long_side)
    return Decoded(
        pixels,
        clipped,
        (samples.shape[1], samples.shape[0]),
        orientation if orientation in range(1, 9) else 1,
        radiometric=True,
        gain_map_applied=corrections.has_maps,
        notes=corrections.notes,
    )


def develop(
    samples: NDArray[Any], sensor: MosaicLevels, corrections: Corrections, long_side: int | None
) -> Rows:
    """Stored numbers, (H, W) of a mosaic or (H, W, 3), to linear Rec.709 and the clip mask."""
    size = (samples.shape[0], samples.shape[1])
    planes = 1 if sensor.pattern is not None else 3
    before, after = (
        Shading(maps, size, size) for maps in (corrections.on_mosaic, corrections.after_demosaic)
    )
    headroom = before.largest(planes) if before.maps else 1.0
    matrix = sensor.to_rec709.T.astype(np.float32)

    def balanced(top: int, bottom: int) -> Rows:
        """Rows of samples in parts of headroom, white-balanced, and which were saturated."""
        stored = samples[top:bottom].reshape(bottom - top, size[1], planes)
        code = stored if sensor.table is None else sensor.table[_within(stored, sensor.table)]
        sites = np.ix_(np.arange(top, bottom), np.arange(size[1]))
        black = _repeated(sensor.black, *sites)
        lift = (
            sensor.lift
            if sensor.pattern is None
            else sensor.lift[_repeated(sensor.pattern, *sites)][..., None]
        )
        light = ((code - black) / (sensor.white - black)).astype(np.float32)
        saturated = light >= CLIP_SHARE / lift
        if before.maps:
            light *= before.gains(top, bottom, planes)
        return np.clip(light * np.float32(1 / headroom) * lift, 0.0, 1.0), saturated.any(axis=-1)

    if sensor.pattern is None:
        camera = balanced
    else:
        colors, saturated = _demosaic(balanced, sensor.pattern, size)

        def camera(top: int, bottom: int) -> Rows:
            return colors[top:bottom].astype(np.float32) / np.float32(_FULL), saturated[top:bottom]

    def read(top: int, bottom: int) -> Rows:
        light, clipped = camera(top, bottom)
        if after.maps:
            light = light * after.gains(top, bottom, 3)
        return np.maximum(light @ matrix, 0.0) * np.float32(headroom), clipped

    return shrink(read, size[1], size[0], long_side)


def _demosaic(
    balanced: ReadRows, pattern: NDArray[np.intp], size: tuple[int, int]
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """The whole mosaic in 16 bits, bilinearly interpolated to (H, W, 3); and the mask, widened."""
    import cv2

    mosaic = np.empty(size, np.uint16)
    mask = np.empty(size, np.uint8)
    step = max(1, (1 << 20) // size[1])
    for top in range(0, size[0], step):
        bottom = min(top + step, size[0])
        light, mask[top:bottom] = balanced(top, bottom)
        mosaic[top:bottom] = np.rint(light[..., 0] * _FULL)
    name = "".join("RGB"[color] for color in pattern.ravel())
    colors = cv2.demosaicing(mosaic, getattr(cv2, f"COLOR_Bayer{name}2RGB"))
    return np.asarray(colors, np.uint16), cv2.dilate(mask, np.ones((3, 3), np.uint8)).astype(
        np.bool_
    )


def _sensor(page: Any, planes: int) -> MosaicLevels:  # noqa: ANN401
    repeat = [int(n) for n in _numbers(page, _BLACK_REPEAT, (1, 1))]
    black = np.array(_numbers(page, _BLACK, (0.0,)))
    count = repeat[0] * repeat[1] * planes
    neutral = np.array(_numbers(page, _NEUTRAL, (1.0, 1.0, 1.0)))
    depth = int(page.bitspersample)
    table = _numbers(page, _LINEARIZATION, ())
    pattern = None
    if _CFA_PATTERN in page.tags:
        pattern = np.array(list(bytes(page.tags[_CFA_PATTERN].value)), np.intp).reshape(2, 2)
    white = _numbers(page, _WHITE, (2.0**depth - 1,))[0]
    bayer = pattern is None or pattern.ravel().tolist() in _BAYER
    if white <= black.max() or neutral.min() <= 0 or not bayer:
        raise ValueError("the levels or colours make no sense")
    return MosaicLevels(
        black=np.resize(black, count).reshape(*repeat, planes),
        white=white,
        lift=neutral.max() / neutral,
        to_rec709=_to_rec709(page),
        pattern=pattern,
        table=np.array(table) if table else None,
    )


def _to_rec709(page: Any) -> NDArray[np.float64]:  # noqa: ANN401
    """Invert the ColorMatrix for daylight (else the last), with grey kept grey."""
    found = {}
    for matrix, illuminant in zip(_COLOR_MATRICES, _ILLUMINANTS, strict=True):
        if matrix in page.tags:
            found[int(_numbers(page, illuminant, (0,))[0])] = _numbers(page, matrix, ())
    if not found:
        return np.eye(3)
    chosen = found.get(_D65, list(found.values())[-1])
    camera = np.array(chosen).reshape(3, 3) @ _REC709_TO_XYZ
    return np.linalg.inv(camera / camera.sum(axis=1, keepdims=True))


def _numbers(page: Any, tag: int, default: tuple[float, ...]) -> tuple[float, ...]:  # noqa: ANN401
    """A tag's numbers; rationals come from tifffile as numerator, denominator, numerator, ..."""
    if tag not in page.tags:
        return default
    value = page.tags[tag].value
    flat = [float(number) for number in np.ravel(np.asarray(value, dtype=np.float64))]
    if int(page.tags[tag].dtype) in (5, 10):
        return tuple(top / bottom for top, bottom in zip(flat[::2], flat[1::2], strict=True))
    return tuple(flat)


def _repeated(
    tile: NDArray[Any], rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[Any]:
    return tile[rows % tile.shape[0], columns % tile.shape[1]]


def _within(stored: NDArray[Any], table: NDArray[np.float64]) -> NDArray[Any]:
    return np.minimum(stored, table.size - 1)
