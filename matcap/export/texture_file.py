"""A texture of an export: its values as a function of the maps, and its file format."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.export.job import ExportJob, MapRows, Picture, bands
from matcap.export.options import CONTAINERS, Container, Depth
from matcap.files.color import srgb_decode, srgb_picture
from matcap.files.exr import LARGEST_HALF, write_exr
from matcap.files.pixels import PNG_HEADER, png_bytes, png_chunk, quantised, swap_red_blue

WRITERS = 2  # textures written in parallel: each holds one picture in memory
_JPEG_QUALITY = 95


@dataclass(frozen=True)
class TextureFile:
    """Content and encoding of a texture."""

    make: Callable[[MapRows], Picture]
    """Computes the values that the target should read, of a rectangle of the maps: (H, W),
    (H, W, 3), or (H, W, 4) with alpha. Integers are clipped to [0, 1]."""
    depth: Depth
    """Integers of 8 or 16 bits, or floats ("half", "float")."""
    srgb: bool = False
    """Integers are sRGB-encoded; floats are linear."""
    meaning: str = ""
    """Meaning of the values, for the sidecar."""
    container: Container = "png"
    """File format."""
    eight_of_16: bool = False
    """Choose 16-bit values whose upper byte is the nearest 8-bit value, for browsers, which drop
    the lower byte; costs readers of 16 bits up to half an 8-bit step."""

    @staticmethod
    def of(
        job: ExportJob,
        make: Callable[[MapRows], Picture],
        usual: Depth,
        meaning: str,
        *,
        srgb: bool = False,
        lossy: bool = True,
    ) -> TextureFile:
        """A texture in the job's format and depth, or in default ones.

        Args:
            usual: default depth.
            srgb: integers are sRGB-encoded.
            lossy: JPEG is allowed; otherwise PNG is written instead.

        Raises:
            UsageError: the format has not this depth.
        """
        depth, container = job.options.bits or usual, job.options.container
        if container is None:
            container = "png" if depth in CONTAINERS["png"] else "exr"
        elif container == "jpg" and not lossy:
            container = "png"
        if job.options.bits is None and usual not in CONTAINERS[container]:
            depth = "half" if container == "exr" else CONTAINERS[container][-1]
        if depth not in CONTAINERS[container]:
            remedy = f"give {' or '.join(CONTAINERS[container])}"
            raise UsageError.at("--bits", f"{container} has no depth {depth}", remedy)
        return TextureFile(make, depth, srgb, meaning, container)

    @property
    def suffix(self) -> str:
        """Suffix of the file, with the dot."""
        return f".{self.container}"

    @property
    def whole(self) -> bool:
        """Whether the file holds integers."""
        return self.depth in ("8", "16")

    @property
    def colour_space(self) -> Literal["sRGB", "linear"]:
        """Colour space that readers must assume."""
        return "sRGB" if self.srgb and self.whole else "linear"

    def stored(self, piece: MapRows) -> NDArray[Any]:
        """The encoded values of a rectangle of the maps.

        Raises:
            MatcapError: a value is not finite, or too large for half float.
        """
        values = self.make(piece)
        if not np.isfinite(values).all():
            raise MatcapError(
                "the maps have values that are not finite", remedy="write the map set again"
            )
        if self.whole:
            coded = _curved(values) if self.srgb else values
            whole = quantised(coded, bits=int(self.depth))
            if not (self.eight_of_16 and self.depth == "16"):
                return whole
            least = quantised(coded, bits=8).astype(np.uint16) * np.uint16(256)
            return np.clip(whole, least, least + np.uint16(255))
        if self.depth == "half" and np.abs(values).max(initial=0.0) > LARGEST_HALF:
            raise MatcapError(
                "the maps have values too large for half float (65504)", remedy="give --bits float"
            )
        return values.astype(np.float16 if self.depth == "half" else np.float32)

    def seen(self, piece: MapRows) -> Picture:
        """The decoded values that a reader gets, with rounding and clipping."""
        stored = self.stored(piece)
        if not self.whole:
            return stored.astype(np.float32)
        code = stored / np.float64(2 ** int(self.depth) - 1)
        if self.srgb:
            colours = code if code.ndim == 2 else code[..., :3]  # not alpha
            colours[...] = srgb_decode(colours)
        return code.astype(np.float32)

    def in_browsers(self) -> TextureFile:
        """The texture as browsers read it: 8 bits of 16."""
        return replace(self, depth="8") if self.depth == "16" else self

    def pixels(self, job: ExportJob) -> NDArray[np.uint8] | NDArray[np.uint16] | Picture:
        """The encoded picture, computed in bands of rows to bound memory."""
        _, height = job.maps.size
        top, *rest = bands(height)
        first = self.stored(job.piece(top))
        whole = np.empty((height, *first.shape[1:]), dtype=first.dtype)
        whole[: len(first)] = first
        for rows in rest:
            whole[rows] = self.stored(job.piece(rows))
        return whole

    def encoded(self, job: ExportJob, *, tagged: bool = True) -> bytes:
        """The file's content, of PNG and JPEG.

        Args:
            tagged: PNG states colour space and texel size.
        """
        whole: Any = self.pixels(job)
        if self.container == "png":
            return _tagged(png_bytes(whole), self, job) if tagged else png_bytes(whole)
        flags = [
            cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
            cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
        ]  # fmt: skip
        _, encoded = cv2.imencode(".jpg", swap_red_blue(whole), flags)
        return encoded.tobytes()

    def write(self, path: Path, job: ExportJob) -> None:
        """Write the file; not atomic, so into a staged folder.

        Raises:
            MatcapError: a value is not finite.
            OSError: the file cannot be written.
        """
        if self.container == "exr":
            write_exr(path, self.pixels(job).astype(np.float32), half=self.depth == "half")
        else:
            path.write_bytes(self.encoded(job))


def _curved(values: Picture) -> Picture:
    """Apply the sRGB curve, but for alpha."""
    if values.shape[-1] != 4:
        return srgb_picture(values)
    return np.concatenate([srgb_picture(values[..., :3]), values[..., 3:]], axis=-1)


def _tagged(png: bytes, texture: TextureFile, job: ExportJob) -> bytes:
    """Add chunks to a PNG: sRGB and gAMA (or gAMA alone if linear), and pHYs with a texel's size.

    PNG specification, third edition, section 11.3.
    """
    gamma = 45455 if texture.srgb else 100000
    chunks = png_chunk(b"sRGB", b"\0") if texture.srgb else b""
    chunks += png_chunk(b"gAMA", struct.pack(">I", gamma))
    if job.millimetres is not None:
        texel = job.maps.texel_size * job.millimetres / 1000.0
        metre = min(max(1, round(1.0 / texel)), 2**31 - 1)
        chunks += png_chunk(b"pHYs", struct.pack(">IIB", metre, metre, 1))
    return png[:PNG_HEADER] + chunks + png[PNG_HEADER:]
