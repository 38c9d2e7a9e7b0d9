"""Reads a photograph file of any supported format to a Photo."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.files.quiet import quiet_decoders
from matcap.photo.dng import Corrections, read_corrections
from matcap.photo.exif import Exif, phone_fov, read_exif
from matcap.photo.floating import is_float_dng, read_exr_or_radiance, read_float_dng
from matcap.photo.jxl import read_jxl
from matcap.photo.kind import FileKind, file_kind
from matcap.photo.left_out import leave_transparent_out
from matcap.photo.lossless import read_png_or_tiff
from matcap.photo.lossy import read_heic, read_jpeg, read_webp_or_avif
from matcap.photo.orient import quarter_turn, upright
from matcap.photo.photo import Decoded, Photo
from matcap.photo.raw import read_raw
from matcap.photo.refusals import SHORTEST_SIDE
from matcap.photo.tone import ToneCurve

_DARKEST = 1e-3  # linear; a picture whose maximum is less counts as black
_MOST_CLIPPED = 0.95  # largest share of clipped pixels


def load_photo(
    path: str | Path,
    *,
    long_side: int | None = None,
    fov: float | None = None,
    noise: bool = True,
    white: float | None = None,
) -> Photo:
    """Read a photograph.

    Args:
        path: DNG or other RAW, JPEG, PNG, TIFF (8, 16 bits or float), WebP, AVIF, EXR, Radiance
            HDR, HEIC (extra `heic`). Transparent pixels are left out, as by a mask.
        long_side: downsample to this many pixels along the long side; never upsample.
        fov: field of view across the long side, degrees; None is the file's, or phone_fov().
        noise: compute Photo.noise of a RAW, for which it is developed twice.
        white: value of white in a file of floating-point numbers; None is the file's, or 1.

    Returns:
        The photograph in linear light, its long side along x.

    Raises:
        MatcapError: the file is not a photograph that can be used; the sentence says why.
        UsageError: long_side or fov is out of range.
    """
    path = Path(path)
    _check_request(long_side, fov, white)
    with quiet_decoders():
        picture, exif = _read(path, long_side, noise, white)
    return replace(_photo(picture, exif, fov, str(path), path.name), path=path.absolute())


def _read(
    path: Path, long_side: int | None, noise: bool, white: float | None
) -> tuple[Decoded, Exif]:
    kind = file_kind(path)
    if kind is FileKind.JPEG:
        return read_jpeg(path, long_side)
    if kind is FileKind.HEIC:
        return read_heic(path, long_side)
    if kind in (FileKind.WEBP, FileKind.AVIF):
        return read_webp_or_avif(path, kind.value, long_side)
    if kind in (FileKind.PNG, FileKind.TIFF):
        return read_png_or_tiff(path, kind.value, long_side, white)
    if kind in (FileKind.EXR, FileKind.RADIANCE):
        return read_exr_or_radiance(path, long_side, white), Exif()
    corrections = read_corrections(path) if kind is FileKind.DNG else Corrections()
    if kind is FileKind.DNG and is_float_dng(path):
        return read_float_dng(path, long_side, corrections, white)
    read = partial(read_raw, long_side=long_side, corrections=corrections, noise=noise)
    return (read_jxl(path, read) if corrections.jpeg_xl else read(path)), read_exif(path)


def _photo(
    picture: Decoded,
    exif: Exif,
    fov: float | None,
    where: str,
    name: str,
) -> Photo:
    """Check the picture, and rotate it upright, then to landscape orientation."""
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
        fov=phone_fov(*size) if known is None else known,
        fov_source="assumed" if known is None else source,
        radiometric=picture.radiometric,
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
        tone=ToneCurve() if picture.linear else None,
        headroom=picture.headroom,
        floating=picture.floating,
        development=picture.development,
    )
    if picture.opacity is None:
        return photo
    return leave_transparent_out(photo, lying(picture.opacity), where)


def _check_request(long_side: int | None, fov: float | None, white: float | None) -> None:
    if white is not None and not 0.0 < white < math.inf:
        raise UsageError.at("white", f"{white:g} is no value of white", "give a positive number")
    if long_side is not None and long_side < SHORTEST_SIDE:
        raise UsageError.at(
            "long_side",
            f"{long_side} pixels along the long side are too few",
            f"ask for at least {SHORTEST_SIDE}",
        )
    if fov is not None and not 1.0 <= fov <= 170.0:
        raise UsageError.at(
            "fov",
            f"a field of view of {fov:g} degrees is out of range",
            "give between 1 and 170 degrees across the long side",
        )


def _check_light(picture: Decoded, where: str) -> None:
    if float(picture.pixels.max()) < _DARKEST:
        raise MatcapError.at(
            where, "the picture is all black", "photograph again with the flash on"
        )
    if float(picture.clipped.mean()) > _MOST_CLIPPED:
        raise MatcapError.at(
            where,
            "the picture is all white, every pixel at the clip level",
            "photograph again with less exposure",
        )
