"""One texture of an export: how its values are made of the maps, and how a file holds them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.export.formats import CONTAINERS, Container, Depth, Picture, bands
from matcap.export.job import ExportJob, MapRows
from matcap.files.exr import LARGEST_HALF, write_exr
from matcap.files.png import PNG_HEADER, png_bytes, png_chunk, quantised, swap_red_blue
from matcap.files.srgb import srgb_decode, srgb_picture

TOKEN = "<UDIM>"  # stands for a tile's number in names of files
WRITERS = 2  # textures made at a time: each holds one picture in memory
_JPEG_QUALITY = 95


@dataclass(frozen=True)
class TextureFile:
    """A texture as a file holds it."""

    make: Callable[[MapRows], Picture]
    """(H, W) grey, (H, W, 3) colour or (H, W, 4) with alpha, of a piece of the maps: what the
    target is to read, texel by texel. Whole code values are clipped to [0, 1]."""
    depth: Depth
    """Bits of whole numbers ("8", "16"), or floats ("half", "float")."""
    srgb: bool = False
    """Whole numbers follow the sRGB curve; floats are light itself."""
    meaning: str = ""
    """What the values are, for the sidecar."""
    container: Container = "png"
    """The file's format."""
    udim: bool = False
    """There is one of every tile of a texture set."""
    eight_of_16: bool = False
    """Readers may drop the lower byte of 16 bits, as browsers do: the upper one is the nearest
    number of 8 bits, which costs a reader of both at most half such a step, and half-way
    nothing."""

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
        """A texture in the file format and depth that was asked for, or is usual.

        Args:
            job: what is exported, and how.
            make: its values.
            usual: depth unless another was asked for.
            meaning: of its values.
            srgb: whole numbers follow the sRGB curve.
            lossy: 8 bits will do; otherwise it stays a PNG where JPEG or WebP was asked for.

        Raises:
            UsageError: a format that has no such depth.
        """
        depth, container = job.depth or usual, job.container
        if container in ("jpg", "webp"):
            if not lossy:
                return TextureFile(
                    make, job.depth or usual, srgb, meaning, udim=job.tiles is not None
                )
            depth = job.depth or "8"
        elif container == "exr":
            depth = job.depth or (usual if usual in CONTAINERS["exr"] else "half")
        elif container is None:
            container = "png" if depth in CONTAINERS["png"] else "exr"
        if depth not in CONTAINERS[container]:
            raise UsageError(
                f"{container} has no depth {depth}",
                where="--bits",
                remedy=f"give {' or '.join(CONTAINERS[container])}",
            )
        return TextureFile(make, depth, srgb, meaning, container, job.tiles is not None)

    @property
    def suffix(self) -> str:
        """Of its file, dot included."""
        return f".{TOKEN}.{self.container}" if self.udim else f".{self.container}"

    @property
    def whole(self) -> bool:
        """Whether the file holds whole numbers."""
        return self.depth in ("8", "16")

    @property
    def colour_space(self) -> Literal["sRGB", "linear"]:
        """How readers must take the file's numbers."""
        return "sRGB" if self.srgb and self.whole else "linear"

    def stored(self, piece: MapRows) -> NDArray[Any]:
        """The numbers in the file, of a piece of the maps.

        Raises:
            MatcapError: a value is not finite.
        """
        values = self.make(piece)
        if not np.isfinite(values).all():
            raise MatcapError("the maps have values that are not finite", remedy="make them again")
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
        """The values that a reader gets back: rounded and clipped as the file does."""
        stored = self.stored(piece)
        if not self.whole:
            return stored.astype(np.float32)
        code = stored / np.float64(2 ** int(self.depth) - 1)
        if self.srgb:
            colours = code if code.ndim == 2 else code[..., :3]  # not alpha
            colours[...] = srgb_decode(colours)
        return code.astype(np.float32)

    def in_browsers(self) -> TextureFile:
        """The texture as browsers read it: of 8 bits whatever the file has."""
        return replace(self, depth="8") if self.depth == "16" else self

    def pixels(self, job: ExportJob) -> NDArray[np.uint8] | NDArray[np.uint16] | Picture:
        """The whole picture, made a band of rows at a time: little beside the result is held."""
        _, height = job.maps.size
        top, *rest = bands(height)
        first = self.stored(job.piece(top))
        whole = np.empty((height, *first.shape[1:]), dtype=first.dtype)
        whole[: len(first)] = first
        for rows in rest:
            whole[rows] = self.stored(job.piece(rows))
        return whole

    def encoded(self, job: ExportJob, *, tagged: bool = True) -> bytes:
        """The file as bytes, for PNG, JPEG and WebP.

        Args:
            job: the maps.
            tagged: with the colour space and the size of a texel, in a PNG.
        """
        whole: Any = self.pixels(job)
        if self.container == "png":
            return _tagged(png_bytes(whole), self, job) if tagged else png_bytes(whole)
        import cv2

        # Quality above 100 is lossless to WebP.
        flags = (
            [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
             cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
            if self.container == "jpg"
            else [cv2.IMWRITE_WEBP_QUALITY, 101]
        )  # fmt: skip
        _, encoded = cv2.imencode(f".{self.container}", swap_red_blue(whole), flags)
        return encoded.tobytes()

    def write(self, path: Path, job: ExportJob) -> None:
        """Write the file. Not atomic: write into a staged folder.

        Raises:
            MatcapError: a value is not finite.
            OSError: the file cannot be written.
        """
        if self.container == "exr" and not job.tiled:
            write_exr(path, self.pixels(job).astype(np.float32), half=self.depth == "half")
        elif self.container in ("exr", "tx"):
            from matcap.export.tiled import write_tiled

            write_tiled(path, self.pixels(job), srgb=self.colour_space == "sRGB", wrap=job.wrap)
        else:
            path.write_bytes(self.encoded(job))


def _curved(values: Picture) -> Picture:
    """On the sRGB curve; alpha stays as it is."""
    if values.shape[-1] != 4:
        return srgb_picture(values)
    return np.concatenate([srgb_picture(values[..., :3]), values[..., 3:]], axis=-1)


def _tagged(png: bytes, texture: TextureFile, job: ExportJob) -> bytes:
    """A PNG that says how its numbers are to be read, and how long a texel is if that is known.

    Chunks sRGB and gAMA, or gAMA alone for linear numbers, and pHYs (PNG 3rd edition, 11.3).
    """
    gamma = 45455 if texture.srgb else 100000
    chunks = png_chunk(b"sRGB", b"\0") if texture.srgb else b""
    chunks += png_chunk(b"gAMA", struct.pack(">I", gamma))
    if job.millimetres is not None:
        texel = job.maps.texel_size * job.millimetres / 1000.0
        metre = min(max(1, round(1.0 / texel)), 2**31 - 1)
        chunks += png_chunk(b"pHYs", struct.pack(">IIB", metre, metre, 1))
    return png[:PNG_HEADER] + chunks + png[PNG_HEADER:]
