"""Writes an image to a file: linear EXR or sRGB PNG, by suffix."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.files.exr import write_exr
from matcap.files.names import check_suffix
from matcap.files.output import Output
from matcap.files.png import quantised, write_png
from matcap.files.srgb import srgb_picture

SUFFIXES = (".exr", ".png")


def jpeg_bytes(linear: NDArray[np.float32], quality: int, **options: int) -> bytes:
    """A JPEG of a linear Rec.709 picture (H, W, 3), encoded by Pillow with these options."""
    from PIL import Image

    stored = io.BytesIO()
    codes = quantised(srgb_picture(linear), bits=8)
    Image.fromarray(codes).save(stored, "JPEG", quality=quality, **options)
    return stored.getvalue()


def write_picture(image: NDArray[np.float32], path: Path) -> None:
    """Write a linear Rec.709 picture (H, W, 3): .exr as float32 radiance, .png as 8-bit sRGB.

    Raises:
        UsageError: another suffix.
        MatcapError: values that are not finite, or the file cannot be written.
    """
    check_suffix(path, SUFFIXES, "picture")
    with Output.file(path) as file:
        if path.suffix.lower() == ".exr":
            write_exr(file, image, half=False)
        else:
            write_png(file, srgb_picture(image), bits=8)
