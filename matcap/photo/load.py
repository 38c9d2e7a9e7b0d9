"""load_photo: any photograph file to a Photo, or one sentence on why not."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.files.color import LINEAR
from matcap.files.quiet import quiet_decoders
from matcap.files.stated_color import StatedColor
from matcap.photo.decoded import Decoded
from matcap.photo.developed import Coded, decode
from matcap.photo.dng import Corrections, read_corrections
from matcap.photo.exif import Exif, read_exif
from matcap.photo.jxl import read_jxl
from matcap.photo.kind import FileKind, file_kind
from matcap.photo.left_out import leave_transparent_out
from matcap.photo.lossless import read_png_or_tiff
from matcap.photo.lossy import read_heic, read_jpeg, read_webp_or_avif
from matcap.photo.orient import quarter_turn, upright
from matcap.photo.photo import DEFAULT_FOV, Photo
from matcap.photo.raw import read_raw
from matcap.photo.refusals import SHORTEST_SIDE, check_size

_DARKEST = 1e-3  # linear: a picture with nothing brighter shows no texture
_MOST_CLIPPED = 0.95  # share of clipped pixels beyond which there is nothing to measure


def load_photo(
    path: str | Path,
    *,
    long_side: int | None = None,
    fov: float | None = None,
    noise: bool = True,
) -> Photo:
    """Read a photograph, whatever it is stored as.

    Args:
        path: DNG or other RAW, JPEG, PNG, TIFF (8, 16 bits or float), WebP, AVIF, HEIC (extra
            `heic`). What is transparent in it is left out, as by a mask.
        long_side: average down to this many pixels along the long side; never up.
        fov: field of view across the long side, degrees; by default the file's, or 45.
        noise: draw a RAW's noise once more (Photo.noise), for which it is developed twice.

    Returns:
        The photograph in linear light, its long side along x.

    Raises:
        MatcapError: the file is not a photograph that can be used; the sentence says why.
        UsageError: long_side or fov is out of range.
    """
    path = Path(path)
    _check_request(long_side, fov)
    with quiet_decoders():
        picture, exif = _read(path, long_side, noise)
    return replace(_photo(picture, exif, fov, str(path), path.name), path=path.absolute())


def photo_from_array(
    pixels: NDArray[Any],
    *,
    long_side: int | None = None,
    fov: float | None = None,
    radiometric: bool = False,
    name: str = "array",
) -> Photo:
    """Take linear light from Python.

    Args:
        pixels: (H, W, 3) floating point, linear Rec.709, white-balanced, clipping at 1.0.
            Negative values become 0.
        long_side: average down to this many pixels along the long side; never up.
        fov: field of view across the long side, degrees; 45 by default.
        radiometric: whether the numbers are proportional to light.
        name: for reports.

    Raises:
        MatcapError: NaN or infinite values, too small, all black or all clipped.
        UsageError: not (H, W, 3) floats; long_side or fov out of range.
    """
    _check_request(long_side, fov)
    array = np.asarray(pixels)
    if array.ndim != 3 or array.shape[2] != 3 or not np.issubdtype(array.dtype, np.floating):
        raise UsageError(
            f"pixels are {array.dtype} of shape {array.shape}, not floats of shape (H, W, 3)",
            where=name,
            remedy="give linear light, 1.0 at the clip level",
        )
    height, width = array.shape[:2]
    check_size(Path(name), width, height)
    coded = Coded(
        lambda a, b: array[a:b], width, height, array.dtype, color=StatedColor(space=LINEAR)
    )
    picture = decode(coded, long_side, name, 1)
    return _photo(picture, Exif(), fov, name, name, radiometric)


def _read(path: Path, long_side: int | None, noise: bool) -> tuple[Decoded, Exif]:
    kind = file_kind(path)
    if kind is FileKind.JPEG:
        return read_jpeg(path, long_side)
    if kind is FileKind.HEIC:
        return read_heic(path, long_side)
    if kind in (FileKind.WEBP, FileKind.AVIF):
        return read_webp_or_avif(path, kind.value, long_side)
    if kind in (FileKind.PNG, FileKind.TIFF):
        return read_png_or_tiff(path, kind.value, long_side)
    corrections = read_corrections(path) if kind is FileKind.DNG else Corrections()
    read = partial(read_raw, long_side=long_side, corrections=corrections, noise=noise)
    return (read_jxl(path, read) if corrections.jpeg_xl else read(path)), read_exif(path)


def _photo(
    picture: Decoded,
    exif: Exif,
    fov: float | None,
    where: str,
    name: str,
    radiometric: bool | None = None,
) -> Photo:
    """Turn the picture upright and its long side along x, and judge it."""
    _check_light(picture, where)
    size = picture.size if picture.orientation < 5 else picture.size[::-1]
    turned = size[1] > size[0]

    def lying(stored: NDArray[Any]) -> NDArray[Any]:
        standing = upright(stored, picture.orientation)
        return np.ascontiguousarray(quarter_turn(standing) if turned else standing)

    stated, said = exif.view(*picture.size)
    known, source, said = (fov, "given", ()) if fov is not None else (stated, "exif", said)
    photo = Photo(
        pixels=lying(picture.pixels),
        clipped=lying(picture.clipped),
        fov=DEFAULT_FOV if known is None else known,
        fov_source="assumed" if known is None else source,
        radiometric=picture.radiometric if radiometric is None else radiometric,
        name=name,
        original_size=size,
        turned=turned,
        flash_fired=exif.flash_fired,
        gain_map_applied=picture.gain_map_applied,
        notes=picture.notes + said,
        stored_clipped_share=picture.clipped_share,
        noise=None if picture.noise is None else lying(picture.noise),
        exposure=exif.exposure,
        balance=picture.balance,
        camera=exif.camera,
    )
    if picture.opacity is None:
        return photo
    return leave_transparent_out(photo, lying(picture.opacity), where)


def _check_request(long_side: int | None, fov: float | None) -> None:
    if long_side is not None and long_side < SHORTEST_SIDE:
        raise UsageError(
            f"{long_side} pixels along the long side are too few",
            where="long_side",
            remedy=f"ask for at least {SHORTEST_SIDE}",
        )
    if fov is not None and not 1.0 <= fov <= 170.0:
        raise UsageError(
            f"a field of view of {fov:g} degrees is out of range",
            where="fov",
            remedy="give between 1 and 170 degrees across the long side",
        )


def _check_light(picture: Decoded, where: str) -> None:
    if float(picture.pixels.max()) < _DARKEST:
        raise MatcapError(
            "the picture is all black", where=where, remedy="photograph again with the flash on"
        )
    if float(picture.clipped.mean()) > _MOST_CLIPPED:
        raise MatcapError(
            "the picture is all white, every pixel at the clip level",
            where=where,
            remedy="photograph again with less exposure",
        )
