"""Writes radiance to files: exposed and encoded (PNG), or linear (EXR)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import srgb_picture
from matcap.files.exr import write_exr
from matcap.files.names import check_suffix
from matcap.files.output import Output
from matcap.files.pixels import png_bytes
from matcap.relight.scene import Film

Radiance = NDArray[np.float32]
# Rows encoded together, to bound memory.
_STRIP = 256


def check_path(path: Path) -> None:
    """Raise UsageError unless the suffix is a picture's."""
    check_suffix(path, (".png", ".exr"), "picture")


def encode(radiance: Radiance, film: Film) -> Radiance:
    """Code values in [0, 1]: radiance times 2^exposure, clipped, through the transfer function."""
    light = radiance * np.float32(film.gain)
    return srgb_picture(light) if film.transfer == "srgb" else np.clip(light, 0.0, 1.0)


def write_rendering(radiance: Radiance, path: Path, film: Film) -> None:
    """Write a picture: .exr as float32 radiance, .png as 8-bit codes.

    Raises:
        UsageError: another suffix.
        MatcapError: values that are not finite; the file cannot be written.
    """
    check_path(path)
    with Output.file(path) as file:
        if path.suffix.lower() == ".exr":
            write_exr(file, radiance, half=False)
        else:
            if not all(np.isfinite(row).all() for row in radiance):
                raise MatcapError.at(
                    path.name,
                    "the picture has values that are not finite",
                    "write it as .exr to see where",
                )
            file.write_bytes(png_bytes(_codes(radiance, film)))


def _codes(frame: Radiance, film: Film) -> NDArray[np.uint8]:
    codes = np.empty(frame.shape, dtype=np.uint8)
    for top in range(0, len(frame), _STRIP):
        strip = slice(top, top + _STRIP)
        codes[strip] = np.rint(encode(frame[strip], film) * 255.0)
    return codes
