"""The photograph beside the material, as a picture that a browser shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_LONG_SIDE = 1024
_PHOTOGRAPHS = (".dng", ".jpg", ".jpeg", ".png", ".tif", ".tiff", ".heic", ".cr2", ".nef", ".arw")


@dataclass(frozen=True)
class EncodedPicture:
    """What stands beside the material.

    Attributes:
        data: a file's bytes.
        kind: its media type.
        sheet: it is the sheet that a capture writes, not the photograph alone.
    """

    data: bytes
    kind: str
    sheet: bool = False


def find_photograph(path: Path, name: str) -> Path | None:
    """The photograph in a capture's folder: of the material's name, else the capture's sheet."""
    folder = path if path.is_dir() else path.parent
    for suffix in _PHOTOGRAPHS:
        for file in (folder / f"{name}{suffix}", folder / f"photo{suffix}"):
            if file.is_file():
                return file
    sheet = folder / "preview.png"
    return sheet if sheet.is_file() else None


def browser_picture(file: Path) -> EncodedPicture:
    """A photograph as JPEG of at most 1024 pixels a side; the capture's sheet as it is.

    Raises:
        MatcapError: the file is not a photograph that matcap reads.
    """
    if file.name == "preview.png":
        return EncodedPicture(file.read_bytes(), "image/png", sheet=True)
    import io

    import numpy as np
    from PIL import Image

    from matcap.files.srgb import srgb_picture
    from matcap.photo.load import load_photo

    pixels = srgb_picture(load_photo(file, long_side=_LONG_SIDE, noise=False).pixels)
    stored = io.BytesIO()
    Image.fromarray(np.rint(pixels * 255.0).astype(np.uint8)).save(stored, "JPEG", quality=90)
    return EncodedPicture(stored.getvalue(), "image/jpeg")
