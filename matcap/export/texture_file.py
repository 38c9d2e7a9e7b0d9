"""One texture of an export: its values, and how a file holds them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.exr import LARGEST_HALF, write_exr
from matcap.files.png import png_bytes, quantised
from matcap.files.srgb import srgb_decode, srgb_picture

Depth = Literal["8", "16", "half", "float"]


@dataclass(frozen=True)
class Stored:
    """A texture as a file holds it.

    Attributes:
        values: (H, W) grey, (H, W, 3) colour or (H, W, 4) with alpha; what the target is to
            read. PNGs clip it to [0, 1].
        depth: bits of a PNG ("8", "16"), or floats of an EXR ("half", "float").
        srgb: a PNG stores the sRGB curve of the values; an EXR stores light itself.
        meaning: what the values are, for the sidecar.
    """

    values: NDArray[np.float32]
    depth: Depth
    srgb: bool = False
    meaning: str = ""

    @property
    def suffix(self) -> str:
        """Of its file: .png or .exr."""
        return ".png" if self.depth in ("8", "16") else ".exr"

    @property
    def colour_space(self) -> Literal["sRGB", "linear"]:
        """How readers must take the file's numbers."""
        return "sRGB" if self.srgb and self.suffix == ".png" else "linear"

    def png(self) -> bytes:
        """The PNG file.

        Raises:
            MatcapError: a value is not finite.
        """
        return png_bytes(self._whole())

    def write(self, path: Path) -> None:
        """Write the file. Not atomic: write into a staged folder.

        Raises:
            MatcapError: a value is not finite.
            OSError: the file cannot be written.
        """
        if self.suffix == ".png":
            path.write_bytes(self.png())
        else:
            write_exr(path, self.values, half=self.depth == "half")

    def seen(self) -> NDArray[np.float32]:
        """The values that a reader gets back: rounded and clipped as the file does."""
        if self.depth == "float":
            return self.values
        if self.depth == "half":
            held = np.clip(self.values, -LARGEST_HALF, LARGEST_HALF)  # writing refuses the rest
            return held.astype(np.float16).astype(np.float32)
        code = self._whole() / np.float64(2 ** int(self.depth) - 1)
        return (srgb_decode(code) if self.srgb else code).astype(np.float32)

    def _whole(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        if not np.isfinite(self.values).all():
            raise MatcapError("the maps have values that are not finite", remedy="make them again")
        coded = srgb_picture(self.values) if self.srgb else self.values
        return quantised(coded, bits=int(self.depth))
