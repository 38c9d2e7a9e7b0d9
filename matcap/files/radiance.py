"""Headers of Radiance HDR images: exposure, primaries and orientation [ward1991; larson1998].

Lines of text up to an empty one, then the resolution, such as `-Y 512 +X 1024`: axis and number of
the scanlines, then axis and number of the texels in each; `-Y` is down, `+X` right. Stored radiance
is true radiance times the product of all EXPOSURE and COLORCORR entries. FORMAT is RGB or CIE XYZ.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.files.rec709 import XYZ

MAGIC = b"#?"
_LONGEST = 1 << 16  # bytes of a header
_RESOLUTION = re.compile(rb"([+-])([XY]) +(\d{1,6}) +([+-])([XY]) +(\d{1,6}) *\r?\n")


@dataclass(frozen=True)
class RadianceHeader:
    """A Radiance header."""

    length: int
    """Length of the header in bytes."""
    scanlines: int
    """Number of scanlines."""
    texels: int
    """Number of texels in a scanline."""
    columns: bool
    """Whether scanlines are columns."""
    flips: tuple[bool, bool]
    """Whether y runs up, and x left."""
    exposure: NDArray[np.float64]
    """(3,) stored over true radiance."""
    primaries: tuple[float, ...] | None
    """Primaries as in EXR's chromaticities, or None."""

    def plain(self) -> bytes:
        """A minimal header for the same scanlines, in standard orientation and RGB."""
        size = f"-Y {self.scanlines} +X {self.texels}\n"
        return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{size}".encode()

    def upright(self, stored: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W, 3) upright true radiance of stored values (scanlines, texels, 3)."""
        picture = stored.transpose(1, 0, 2) if self.columns else stored
        picture = picture[:: -1 if self.flips[0] else 1, :: -1 if self.flips[1] else 1]
        return np.ascontiguousarray(picture / self.exposure.astype(np.float32))


def radiance_header(path: Path) -> RadianceHeader:
    """Read the header of a file that begins with MAGIC.

    Raises:
        ValueError: the header is damaged, or of an unknown format.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_LONGEST)
    end = re.search(rb"\n\r?\n", head)
    match = end and _RESOLUTION.match(head, end.end())
    if not end or not match:
        raise ValueError("it has no resolution")
    lines = [line.strip() for line in head[: end.start()].decode("latin-1").split("\n")[1:]]
    entries = [line.split("=", 1) for line in lines if "=" in line]
    formats = [value.strip() for key, value in entries if key.strip() == "FORMAT"]
    xyz = any(value == "32-bit_rle_xyze" for value in formats)
    if not xyz and any(value != "32-bit_rle_rgbe" for value in formats):
        raise ValueError(f"its format is {formats[0][:40]!r}")
    exposure = np.ones(3)
    primaries: tuple[float, ...] | None = XYZ if xyz else None
    for key, value in entries:
        numbers = [float(word) for word in value.split()] if key in _NUMBERS else []
        if len(numbers) != _NUMBERS.get(key, 0):
            raise ValueError(f"its {key} is {value[:40]!r}")
        if key == "PRIMARIES":
            primaries = tuple(numbers)
        elif numbers:
            exposure = exposure * numbers
    if not (np.isfinite(exposure).all() and exposure.min() > 0.0):
        raise ValueError("its exposure is none")
    (first, axis, scanlines), (second, other, texels) = match.groups()[:3], match.groups()[3:]
    if axis == other or not int(scanlines) or not int(texels):
        raise ValueError("its resolution is none")
    signs = {axis: first, other: second}
    flips = signs[b"Y"] == b"+", signs[b"X"] == b"-"
    return RadianceHeader(
        match.end(), int(scanlines), int(texels), axis == b"X", flips, exposure, primaries
    )


_NUMBERS = {"EXPOSURE": 1, "COLORCORR": 3, "PRIMARIES": 8}
