"""Reads photographs that are no RAW: code values or light of a file to linear Rec.709, smaller.

Code values are not radiometric: the camera's tone curve is unknown, and only the transfer function
of the colour space is inverted. Floating-point numbers (EXR, Radiance HDR, TIFF, DNG) are light,
and are kept: exposures of one scene stay comparable, and one hot pixel changes no other. White is
1, a DNG's WhiteLevel, or what the user gives (`white`). Light above white is measured up to the
value that many pixels share as the largest of a channel (clip_level).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files import containers
from matcap.files.color import LINEAR, Linearise, largest_code
from matcap.files.containers import FileKind
from matcap.files.pixels import Pixels, decoded, linear_colours
from matcap.files.stated_color import StatedColor, stated_color
from matcap.photo import hdr_gain_map
from matcap.photo.exif import Exif, read_exif
from matcap.photo.hdr_gain_map import HdrGainMap, applied
from matcap.photo.left_out import Rows, area_averaged, shrink, shrunk_size
from matcap.photo.photo import (
    WITH_BRIGHT_GAINS,
    WITH_GAIN_MAP,
    Decoded,
    Development,
    Photo,
    ToneCurve,
    check_size,
)

_LOSSY = (FileKind.JPEG, FileKind.WEBP, FileKind.AVIF, FileKind.HEIC)
_LOSSY_CLIP = 254.0 / 255.0  # as lossy coding may decode 255 to 254
_LARGEST = 1e30  # values that matrices and means keep finite
_WIDEST_META = 1 << 16  # first bytes of a HEIC or AVIF in which its items are searched
# A largest value that so many pixels share, and so large a share of them, is where values clip.
_SHARED, _SHARED_SHARE = 16, 1e-4
_MOST_SHARED = 0.5  # share of all from which on it is a flat picture
_EQUAL = 1e-4  # relative difference of values that count as equal
# Linear light of middle tones in a base picture, and the mean log2 gain of these from which on a
# gain map undoes the tone curve (of two phones' pictures 0.03 and 0.58; docs/notes/gloss.md).
_MIDDLE_TONES, _LEAST_STOPS = (0.03, 0.3), 0.1
_USUAL_MEDIANS = (1e-3, 2.0)  # median of a photograph in units of white; beyond, white is doubtful


@dataclass(frozen=True)
class Coded:
    """A picture of code values, or of light in floating point."""

    codes: NDArray[Any]
    """(H, W, 3) stored values."""
    color: StatedColor = StatedColor()
    """Colour space of the file."""
    clip_at: float = 1.0
    """Share of the largest code value from which on pixels count as clipped; of floating-point
    numbers the value itself."""
    opacity: NDArray[Any] | None = None
    """(H, W) code values of alpha, or None."""
    gain_map: HdrGainMap | None = None
    """HDR gain map on the grid of the picture, or None."""
    white: float = 1.0
    """Light of the file that counts as white."""
    notes: tuple[str, ...] = ()
    """Sentences for the report."""


def read_developed(
    path: Path,
    kind: FileKind,
    long_side: int | None,
    white: float | None,
    tone: ToneCurve | None = None,
) -> tuple[Decoded, Exif]:
    """Read a photograph by the reader of all pictures (files/pixels.py).

    Args:
        long_side: of the result, pixels, or None.
        white: value of white in floating point, by default 1.
        tone: of a developed picture, if known; undone before downsampling.

    Raises:
        MatcapError: as pixels.decoded, or too small.
    """
    pixels = decoded(path, long_side=long_side)
    size = pixels.whole_size or pixels.size
    check_size(path, *size)
    exif = _exif(path, kind, pixels)
    if pixels.whole:
        notes = pixels.notes
        if kind is FileKind.AVIF and (bits := _avif_bits(path)) > 8:
            notes = (*notes, f"The picture's {bits} bits are read as 8.")
        coded = Coded(
            pixels.colours(),
            stated_color(path, pixels.page),
            _LOSSY_CLIP if kind in _LOSSY else 1.0,
            pixels.stored[..., pixels.roles["A"]] if "A" in pixels.roles else None,
            notes=notes,
        )
        coded = _brightened(coded, path, kind, pixels)
    else:
        colours, notes = linear_colours(pixels)
        opacity = pixels.channel("A") if "A" in pixels.roles else None
        coded = replace(light(path, colours, white, pixels.notes + notes), opacity=opacity)
    picture = decode(coded, long_side, tone)
    return replace(picture, photo=replace(picture.photo, original_size=size)), exif


def _exif(path: Path, kind: FileKind, pixels: Pixels) -> Exif:
    """Metadata of a photograph, with the orientation of what is decoded."""
    if kind in (FileKind.EXR, FileKind.RADIANCE):
        return Exif()
    if kind not in (FileKind.HEIC, FileKind.AVIF):
        exif = read_exif(path)
        return replace(exif, orientation=pixels.orientation) if pixels.page else exif
    # Pillow converts an AVIF's rotation to Exif's orientation; a HEIC's has been applied, and the
    # Exif block repeats it.
    exif = read_exif(pixels.info.get("exif") or b"")
    return replace(exif, orientation=1) if kind is FileKind.HEIC else exif


def _avif_bits(path: Path) -> int:
    """Bits per channel; 8 if the file's boxes are damaged."""
    try:
        return containers.primary_properties(path).bits
    except Exception:  # struct.error, KeyError, IndexError and others on damaged boxes
        return 8


def _brightened(coded: Coded, path: Path, kind: FileKind, pixels: Pixels) -> Coded:
    """A picture with the file's HDR gain map; one that cannot be used is noted."""
    height, width = coded.codes.shape[:2]
    try:
        if kind is FileKind.JPEG and hdr_gain_map.has_mark(path):
            exif = hdr_gain_map.exif_ifd(pixels.info.get("exif", b""))
            gain_map = hdr_gain_map.of_jpeg(path.read_bytes(), exif)
        elif pixels.gain_map is not None:
            gain_map = hdr_gain_map.of_heic(path, pixels)
        elif kind is not FileKind.JPEG and kind in _LOSSY and _has_map(path):
            raise ValueError(
                f"decoders of {kind.value} do not return it; export it as a JPEG with its gain "
                "map, or add a darker photograph from the same place"
            )
        else:
            return coded
        gain_map = hdr_gain_map.matching(gain_map, width, height)
    except ValueError as error:
        return replace(coded, notes=(*coded.notes, hdr_gain_map.left_out(str(error))))
    return replace(coded, gain_map=gain_map)


def _has_map(path: Path) -> bool:
    """Whether a WebP, HEIC or AVIF has a gain map, which decoders do not return."""
    with path.open("rb") as file:
        item = b"tmap" in file.read(_WIDEST_META)
    return item or hdr_gain_map.has_mark(path)


def light(
    path: Path, pixels: NDArray[np.float32], white: float | None, notes: tuple[str, ...] = ()
) -> Coded:
    """Light (H, W, 3), linear Rec.709, as Coded, with its clip level.

    Raises:
        MatcapError: values that are NaN, infinite or above 1e30; all of it is so dark that its unit
            cannot be white's.
    """
    known = white or 1.0
    least, largest = float(pixels.min()), float(pixels.max())
    if not max(-least, largest) < _LARGEST:
        raise MatcapError.at(
            path,
            "the picture has values that are NaN or infinite, or above 1e30",
            "export it again without them",
        )
    if least < -1e-3 * max(largest, 1.0):
        notes += (f"Values reach down to {least:.3g}: those below 0 are taken as 0.",)
    middle = float(np.median(pixels[::4, ::4].mean(axis=2))) / known
    if 0.0 < largest < 1e-3 * known:
        raise MatcapError.at(
            path,
            f"its values reach {largest:.3g} only, and white is {known:g}",
            "give --white, the value that is white in it",
        )
    if not _USUAL_MEDIANS[0] < middle < _USUAL_MEDIANS[1]:
        notes += (
            f"Half of the picture is brighter than {middle:.3g} times white: "
            "give --white, the value that is white in it.",
        )
    elif largest > known:
        notes += (f"Light up to {largest / known:.3g} times white is in the file.",)
    color = StatedColor(space=LINEAR)
    return Coded(pixels, color, clip_level(pixels, known), white=known, notes=notes)


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


def decode(coded: Coded, long_side: int | None, tone: ToneCurve | None = None) -> Decoded:
    """Convert to linear Rec.709, strip by strip, without a tone curve if that is known, and
    downsample; `long_side` is in pixels.
    """
    codes, gain_map, scale = coded.codes, coded.gain_map, np.float32(1.0 / coded.white)
    height, width = codes.shape[:2]
    linearise, notes = coded.color.lineariser(codes.dtype)
    whole = np.issubdtype(codes.dtype, np.integer)
    clip_code = coded.clip_at * largest_code(codes.dtype)
    clip_code = np.ceil(clip_code) if whole else clip_code
    linear = gain_map is None and _is_linear(linearise, codes.dtype)
    tone = ToneCurve() if linear else tone
    at_limit, stops = 0, [np.zeros(2)]

    def read(top: int, bottom: int) -> Rows:
        nonlocal at_limit
        rows = codes[top:bottom]
        linear = linearise(rows)
        red, green, blue = (rows[..., channel] >= clip_code for channel in range(3))
        clipped: NDArray[np.bool_] = red | green | blue
        if gain_map is not None:
            base, (linear, at_most) = linear, gain_map.light(linear, slice(top, bottom))
            stops.append(_middle_stops(base, linear))
            clipped &= at_most
        elif scale != 1.0:
            linear = linear * scale
        at_limit += int(np.count_nonzero(clipped))
        return (linear if tone is None else tone.linear(linear)), clipped

    pixels, clipped = shrink(read, width, height, long_side)
    opacity, transparent = _opacity(coded, long_side)
    headroom = _headroom(coded, linearise)
    photo = Photo(
        pixels,
        clipped,
        original_size=(width, height),
        notes=coded.notes + notes + transparent + ((applied(gain_map),) if gain_map else ()),
        stored_clipped_share=at_limit / (width * height),
        tone=tone,
        headroom=headroom if tone is None else float(tone.linear(np.array(headroom))),
        floating=not whole,
        development=_development(np.sum(stops, axis=0)) if gain_map else Development(),
    )
    return Decoded(photo, opacity=opacity)


def _middle_stops(base: NDArray[np.float32], light: NDArray[np.float32]) -> NDArray[np.float64]:
    """Sum of |log2 gain| over texels of middle tones, and their number."""
    dark, bright = _MIDDLE_TONES
    tone, gained = base.mean(axis=-1), light.mean(axis=-1)
    middle = (tone > dark) & (tone < bright) & (gained > 0.0)
    gains = np.abs(np.log2(gained[middle] / tone[middle]))
    return np.array([gains.sum(dtype=np.float64), gains.size])


def _development(stops: NDArray[np.float64]) -> Development:
    """The prior for a gain map, by the sums of _middle_stops."""
    return WITH_GAIN_MAP if stops[0] > _LEAST_STOPS * stops[1] else WITH_BRIGHT_GAINS


def _headroom(coded: Coded, linearise: Linearise) -> float:
    """Light at which channels clip, in units of white: of PQ and HLG, and of floating point."""
    if coded.gain_map is not None:
        return coded.gain_map.headroom
    if math.isinf(coded.clip_at):
        return math.inf
    dtype = coded.codes.dtype
    full = largest_code(dtype) if np.issubdtype(dtype, np.integer) else coded.clip_at
    brightest = float(linearise(np.full((1, 1, 3), full, dtype)).min()) / coded.white
    # Rounding of matrices and curves aside, codes end at white.
    return brightest if abs(brightest - 1.0) > 0.02 else 1.0


def _is_linear(linearise: Linearise, dtype: np.dtype[Any]) -> bool:
    """Whether codes are proportional to light: half of the largest is half of its light."""
    codes = np.array([0.5, 1.0])[:, None, None] * np.full((1, 1, 3), largest_code(dtype))
    half, whole = linearise(codes.astype(dtype)).mean(axis=(1, 2))
    return bool(abs(half / whole - 0.5) < 0.01)


def _opacity(
    coded: Coded, long_side: int | None
) -> tuple[NDArray[np.float32] | None, tuple[str, ...]]:
    """(h, w) share of a pixel's area with alpha above 0.5, or None; and notes.

    Constant alpha is ignored, with a note if it is below 1.
    """
    codes = coded.opacity
    if codes is None:
        return None, ()
    largest = largest_code(codes.dtype)
    if codes.min() == codes.max():
        says = "All of the picture is equally transparent: its transparency is ignored."
        return None, () if codes.flat[0] >= largest else (says,)
    shown = np.where(codes > 0.5 * largest, np.uint8(255), np.uint8(0))
    height, width = codes.shape
    resized = area_averaged(shown, shrunk_size(width, height, long_side))
    return np.asarray(resized / np.float32(255.0), np.float32), ()
