"""Reads PNG and TIFF, and floating-point photographs: EXR, Radiance HDR, TIFF, DNG."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import LINEAR, ColorSpace
from matcap.files.containers import GREYS, Tag, TiffPicture, meant_picture
from matcap.files.exr import forget_error
from matcap.files.pixels import Pixels, linear_colours, read_pixels
from matcap.files.stated_color import StatedColor, stated_color
from matcap.photo.developed import Coded, decode, three_channels
from matcap.photo.dng import Corrections, raw_page
from matcap.photo.exif import Exif, read_exif
from matcap.photo.photo import Decoded, check_size, decoding, missing_extra, unreadable, unsupported
from matcap.photo.raw_samples import normalised

# Reads photographs in floating point: EXR and Radiance HDR, and the raw picture of a float DNG.
#
# Their numbers are light, and are kept: exposures of one scene stay comparable, and one hot pixel
# changes no other. White is 1, a DNG's WhiteLevel, or what the user gives (`white`). Light above
# white is measured up to the value that many pixels share as the largest of a channel (clip_level).


# A largest value that so many pixels share, and so large a share of them, is where values clip.
_SHARED, _SHARED_SHARE = 16, 1e-4
_MOST_SHARED = 0.5  # share of all from which on it is a flat picture
_EQUAL = 1e-4  # relative difference of values that count as equal
_USUAL_MEDIANS = (1e-3, 2.0)  # median of a photograph in units of white; beyond, white is doubtful
_PLAIN = 1  # a compression


def read_exr_or_radiance(path: Path, long_side: int | None, white: float | None) -> Decoded:
    """Read an EXR or Radiance HDR picture; `white` is the value of white, by default 1.

    Raises:
        MatcapError: truncated, damaged, too small, too large, without colours, or with NaN or
            infinite values.
    """
    stored = read_pixels(path)
    check_size(path, *stored.size)
    colours, notes = linear_colours(stored)
    notes = stored.notes + notes
    return decode(
        light(path, colours, white, notes, opacity=_opacity(stored)),
        long_side,
        str(path),
        1,
    )


def light(
    path: Path,
    pixels: NDArray[np.float32],
    white: float | None,
    notes: tuple[str, ...] = (),
    color: StatedColor | None = None,
    opacity: NDArray[np.float32] | None = None,
) -> Coded:
    """A floating-point picture (H, W, 3) as Coded, with its clip level.

    Raises:
        MatcapError: all of it is so dark that its unit cannot be white's.
    """
    finite = pixels if np.isfinite(pixels).all() else np.zeros((1, 1, 3), np.float32)
    level = clip_level(finite, white or 1.0)
    least, largest = float(finite.min()), float(finite.max())
    if least < -1e-3 * max(largest, 1.0):
        notes += (f"Values reach down to {least:.3g}: those below 0 are taken as 0.",)
    middle = float(np.median(finite[::4, ::4].mean(axis=2))) / (white or 1.0)
    if 0.0 < largest < 1e-3 * (white or 1.0):
        raise MatcapError.at(
            path,
            f"its values reach {largest:.3g} only, and white is {white or 1.0:g}",
            "give --white, the value that is white in it",
        )
    if not _USUAL_MEDIANS[0] < middle < _USUAL_MEDIANS[1]:
        notes += (
            f"Half of the picture is brighter than {middle:.3g} times white: "
            "give --white, the value that is white in it.",
        )
    elif largest > (white or 1.0):
        notes += (f"Light up to {largest / (white or 1.0):.3g} times white is in the file.",)
    return Coded(
        lambda top, bottom: pixels[top:bottom],
        pixels.shape[1],
        pixels.shape[0],
        pixels.dtype,
        color or StatedColor(space=LINEAR),
        clip_at=level,
        opacity=opacity,
        notes=notes,
        white=white or 1.0,
    )


def clip_level(pixels: NDArray[np.float32], white: float) -> float:
    """Value at which channels (H, W, 3) clip: white if nothing exceeds it, infinite if unknown.

    Above white, a channel clips at its largest value if many pixels share that; the least of the
    channels' is taken.
    """
    if float(pixels.max()) <= white:
        return white
    levels = [math.inf]
    for channel in range(3):
        plane = pixels[..., channel]
        most = float(plane.max())
        shared = int(np.count_nonzero(plane >= most * (1.0 - _EQUAL)))
        many = max(_SHARED, _SHARED_SHARE * plane.size)
        if many <= shared <= _MOST_SHARED * plane.size:
            levels.append(most * (1.0 - _EQUAL))
    return min(levels)


def _opacity(stored: Pixels) -> NDArray[np.float32] | None:
    return stored.channel("A") if "A" in stored.roles else None


def is_float_dng(path: Path) -> bool:
    """Whether a DNG's raw picture is in floating point."""
    import tifffile

    with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
        page = raw_page(file)
        return page is not None and int(page.sampleformat) == 3


def read_float_dng(
    path: Path, long_side: int | None, corrections: Corrections, white: float | None
) -> tuple[Decoded, Exif]:
    """Read a DNG whose raw picture is in floating point, as merged exposures are.

    LibRaw scales such a picture by its maximum. A mosaic is averaged by 2 x 2. White balance,
    colours, active area and crop are the file's (dng.py).

    Raises:
        MatcapError: truncated, damaged, too small, with lens-shading maps, of another pattern than
            2 x 2, or without a colour matrix.
    """
    import tifffile

    color = corrections.color
    if color is None or corrections.has_maps:
        raise unsupported(path, "a float DNG without a colour matrix, or with gain maps")
    with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
        page: Any = raw_page(file)
        check_size(path, page.imagewidth, page.imagelength)
        if int(page.compression) != _PLAIN and importlib.util.find_spec("imagecodecs") is None:
            raise missing_extra(path, "a compressed float DNG", "jxl")
        samples = normalised(page)
        pattern = bytes(page.tags[Tag.CFAPattern].value) if samples.ndim == 2 else None
    crop = corrections.crop
    camera = samples[..., :3] if pattern is None else _binned(path, samples, pattern)
    size = samples.shape[1], samples.shape[0]
    if crop is not None:
        step = 1 if pattern is None else 2
        top, left, bottom, right = (edge // step for edge in crop.shown)
        camera = camera[top:bottom, left:right]
        size = crop.shown[3] - crop.shown[1], crop.shown[2] - crop.shown[0]
    space = ColorSpace("the camera", LINEAR.curves, color.matrix)
    balanced = np.asarray(camera / np.array(color.neutral, np.float32), np.float32)
    notes = (*corrections.notes, *((color.note,) if color.note else ()))
    coded = light(path, balanced, white, notes, StatedColor(space=space))
    red, green, blue = (1.0 / channel for channel in color.neutral)
    picture = decode(replace(coded, size=size), long_side, str(path), corrections.orientation or 1)
    area = None if crop is None else crop.whole
    whole = None if area is None else (area[3] - area[1], area[2] - area[0])
    picture = replace(picture, radiometric=True, balance=(red, green, blue), whole=whole)
    return picture, read_exif(path)


def _binned(path: Path, samples: NDArray[np.float32], pattern: bytes) -> NDArray[np.float32]:
    """(H / 2, W / 2, 3) means of each colour over the 2 x 2 photosites of a mosaic."""
    if sorted(pattern) != [0, 1, 1, 2]:
        raise unsupported(path, "a float DNG whose mosaic is not of 2 x 2 photosites")
    height, width = (side // 2 * 2 for side in samples.shape)
    sites = [samples[row:height:2, column:width:2] for row in (0, 1) for column in (0, 1)]
    planes = [
        np.mean([s for s, of in zip(sites, pattern, strict=True) if of == c], axis=0)
        for c in range(3)
    ]
    return np.stack(planes, axis=-1)


# Reads PNG and TIFF of 8 and 16 bits, and TIFF in floating point, by OpenImageIO.
#
# Of a TIFF with several pages the largest picture is read, not thumbnails or masks. CMYK and CIELAB
# are refused, as OpenImageIO's conversion is not colorimetric.


def read_png_or_tiff(
    path: Path, form: str, long_side: int | None, white: float | None = None
) -> tuple[Decoded, Exif]:
    """Read a PNG or TIFF of 8 or 16 bits, or a TIFF in floating point (lossless.py).

    Args:
        form: "PNG" or "TIFF".
        long_side: of the result, pixels, or None.
        white: value of white in floating point, by default 1.

    Raises:
        MatcapError: truncated, damaged, too small, too large, not supported, or with NaN or
            infinite values.
    """
    import OpenImageIO as oiio

    page = _page_of(path) if form == "TIFF" else TiffPicture()
    with decoding(path, form):
        config = oiio.ImageSpec()
        config.attribute("oiio:UnassociatedAlpha", 1)  # colours not multiplied by alpha
        source = oiio.ImageInput.open(str(path), config)
        if source is None:
            forget_error(oiio.geterror)  # or it is printed at exit
            raise _broken(path, form, page)
        if page.index and not source.seek_subimage(page.index, 0):
            forget_error(source.geterror)
            raise _broken(path, form, page)
        spec = source.spec()
    check_size(path, spec.width, spec.height)
    alpha = spec.alpha_channel
    stored = _stored_type(spec.format)
    dtype = np.dtype("float32" if stored == "float" else stored)
    in_strips = alpha < 0 and dtype.kind == "u" and not spec.tile_width
    raw_rows = _read_rows(source, spec, stored, lambda: _broken(path, form, page))

    def rows(top: int, bottom: int) -> NDArray[Any]:
        return page.as_meant(raw_rows(top, bottom), alpha)

    notes, opacity = page.notes, None
    if not in_strips:
        whole = rows(0, spec.height)
        if alpha >= 0:
            opacity = np.ascontiguousarray(whole[..., alpha])

        def rows(top: int, bottom: int) -> NDArray[Any]:
            return whole[top:bottom]

    exif = read_exif(path)
    orientation = page.orientation if page.index else None
    if dtype.kind == "f":
        colours = three_channels(rows(0, spec.height))
        color = _color(path, page.index, dtype)
        coded = light(path, colours, white, notes, color, opacity)
        return decode(coded, long_side, str(path), orientation or exif.orientation), exif
    coded = Coded(
        lambda top, bottom: three_channels(rows(top, bottom)),
        spec.width,
        spec.height,
        dtype,
        _color(path, page.index, dtype),
        opacity=opacity,
        notes=notes,
    )
    return decode(coded, long_side, str(path), orientation or exif.orientation), exif


def _read_rows(
    source: Any,  # noqa: ANN401
    spec: Any,  # noqa: ANN401
    stored: str,
    broken: Callable[[], MatcapError],
) -> Callable[[int, int], NDArray[Any]]:
    """A function that reads rows (n, W, C) of an open picture, in order from the top."""
    import OpenImageIO as oiio

    def rows(top: int, bottom: int) -> NDArray[Any]:
        try:
            if (top, bottom) == (0, spec.height):
                codes = source.read_image(source.current_subimage(), 0, 0, spec.nchannels, stored)
            else:
                y = spec.y
                codes = source.read_scanlines(
                    y + top, y + bottom, 0, 0, spec.nchannels, oiio.TypeDesc(stored)
                )
            said = source.has_error
            forget_error(source.geterror)
            if bottom == spec.height:
                source.close()
        except Exception as error:
            raise broken() from error
        if codes is None or said:
            raise broken()
        return np.asarray(codes)

    return rows


def _page_of(path: Path) -> TiffPicture:
    with decoding(path, "TIFF"):
        page = meant_picture(path)
    if page.refused:
        raise unsupported(path, page.refused)
    if page.photometric in GREYS and page.samples > 2:  # two are grey and its alpha
        raise unsupported(
            path, f"a TIFF of {page.samples} bands that are not named red, green and blue"
        )
    return page


def _broken(path: Path, form: str, page: TiffPicture) -> MatcapError:
    if page.usual:
        return unreadable(path, form)
    return unsupported(path, f"TIFF compression {page.compression}")


def _color(path: Path, page: int, dtype: np.dtype[Any]) -> StatedColor:
    color = stated_color(path, page)
    if dtype.kind != "f":
        return color
    # Floating point is linear, in the stated primaries, unless there is a profile.
    space = ColorSpace(LINEAR.name, LINEAR.curves, color.space.matrix)
    return StatedColor(color.profile, space, color.notes)


def _stored_type(form: Any) -> str:  # noqa: ANN401
    """The type to read a format as: uint8, uint16 or float."""
    name = str(form)
    if name in ("half", "float", "double"):
        return "float"
    return "uint8" if name in ("uint8", "int8") else "uint16"
