"""Converts finished EXR files to 16-bit PNGs, a row of tiles at a time.

Values are those of the EXR files, rounded to half floats there; height is scaled by its range.
"""

from __future__ import annotations

import errno
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from matcap.brdf.folder import MEANINGS, coded, height_range
from matcap.errors import MatcapError
from matcap.synth.assembly import Assembly
from matcap.synth.exr_tiles import TILE, TileFile
from matcap.synth.levels import read_planes
from matcap.synth.pictures import PictureFile


def height_coding(assemblies: Sequence[Assembly]) -> tuple[float, float]:
    """(scale, midlevel) with height = (value - midlevel) scale and values from 0 to 1 over all."""
    low, high = np.inf, -np.inf
    for assembly in assemblies:
        picture, file = _holding("height", assembly)
        (place,) = picture.places("height")
        for rows in _strips(file):
            height = read_planes(file, 0, (rows, slice(0, file.layout.width)))[place]
            low, high = min(low, float(height.min())), max(high, float(height.max()))
    return height_range(low, high)


def write_pngs(stage: Path, assembly: Assembly, heights: tuple[float, float]) -> None:
    """Write a PNG of every map into the folder of the EXR files.

    Raises:
        OSError: a file cannot be written.
    """
    for kind in MEANINGS:
        picture, file = _holding(kind, assembly)
        name = picture.file.removesuffix(".exr") + ".png"
        _write_png(stage / name, kind, picture, file, heights)


def _write_png(
    path: Path, kind: str, picture: PictureFile, file: TileFile, heights: tuple[float, float]
) -> None:
    import OpenImageIO as oiio

    layout, places = file.layout, picture.places(kind)
    output = oiio.ImageOutput.create(str(path))
    spec = oiio.ImageSpec(layout.width, layout.height, len(places), "uint16")
    spec.attribute("oiio:ColorSpace", "sRGB" if kind == "diffuse" else "linear")
    spec.attribute("png:compressionLevel", 3)
    if output is None or not output.open(str(path), spec):
        raise OSError(errno.EIO, oiio.geterror())
    done = True
    for rows in _strips(file):
        planes = read_planes(file, 0, (rows, slice(0, layout.width)))
        pixels = np.stack([planes[place] for place in places], axis=-1)
        values = coded(kind, pixels.astype(np.float32), *heights)
        whole = np.rint(np.clip(values, 0.0, 1.0) * 65535.0).astype(np.uint16)
        done = done and output.write_scanlines(rows.start, rows.stop, 0, whole)
    if not (output.close() and done):
        raise OSError(errno.EIO, output.geterror())


def _holding(kind: str, assembly: Assembly) -> tuple[PictureFile, TileFile]:
    """The picture that has the map, and its file."""
    for picture, file in zip(assembly.pictures, assembly.files, strict=True):
        if kind in picture.kinds:
            return picture, file
    raise MatcapError(f"there is no {kind} map")


def _strips(file: TileFile) -> Iterable[slice]:
    height = file.layout.height
    return (slice(y, min(y + TILE, height)) for y in range(0, height, TILE))
