"""Files of a map set: tiled EXR, with mip levels on request, and 16-bit PNGs.

Written by OpenImageIO in strips of rows, from the computed texels (assembly.py). Maps are half
floats, heights 32-bit floats. A mip level is the box average of the next larger one; normals are
averaged and normalised, and roughness does not take up the variance of the normals that is lost.
PNGs hold the values of the EXR files.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.folder import coded, height_range
from matcap.brdf.heights import check_heights
from matcap.files.exr import check_representable
from matcap.files.rec709 import REC709
from matcap.synth.assembly import Assembly, read_texels

_TILE = 64
# (rows, width, channels) of a map.
_Rows = NDArray[Any]


def kind_planes(specular: int) -> dict[str, tuple[int, ...]]:
    """Indices of each map's planes among the stored planes, for a number of channels of F0."""
    counts = {"diffuse": 3, "specular": specular, "roughness": 1, "height": 1, "normal": 3}
    ends = accumulate(counts.values())
    return {
        kind: tuple(range(end - count, end))
        for (kind, count), end in zip(counts.items(), ends, strict=True)
    }


def texel_type(specular: int) -> np.dtype[np.void]:
    """Type of a texel of all maps, for a number of channels of F0."""
    return np.dtype(
        [
            (kind, "<f4" if kind == "height" else "<f2", (len(planes),))
            for kind, planes in kind_planes(specular).items()
        ]
    )


def texels_of(planes: NDArray[np.float32], specular: int) -> NDArray[np.void]:
    """(H, W) texels, in the files' precision, of planes (9 or 11, H, W).

    Raises:
        MatcapError: a value is not finite, or too large for half float.
    """
    texels = np.empty(planes.shape[1:], texel_type(specular))
    for kind, places in kind_planes(specular).items():
        values = planes[list(places)]
        check_representable(kind, values, half=kind != "height")
        if kind == "height":
            check_heights(values, "the material")
        texels[kind] = np.moveaxis(values, 0, -1)
    return texels


def write_map(path: Path, kind: str, texels: Assembly, wrap: str) -> None:
    """Write the EXR file of a map.

    Args:
        wrap: OpenImageIO's wrap modes along x and y of a file with mip levels; "" for one without.

    Raises:
        OSError: the file cannot be written.
    """
    import OpenImageIO as oiio

    width, height = texels.size
    depth = texels.kind[kind].base
    channels = texels.kind[kind].shape[0]

    def whole(rows: slice) -> _Rows:
        return texels.rows(rows)[kind]

    read: Callable[[slice], _Rows] = whole
    levels = max(width, height).bit_length() if wrap else 1
    with ExitStack() as stack:
        output: Any = oiio.ImageOutput.create(str(path))
        for level in range(levels):
            size = max(width >> level, 1), max(height >> level, 1)
            spec = oiio.ImageSpec(*size, channels, "half" if depth.itemsize == 2 else "float")
            spec.channelnames = tuple("RGB" if channels == 3 else "Y")
            spec.tile_width = spec.tile_height = _TILE
            spec.attribute("compression", "zip")
            spec.attribute("DateTime", "")  # else the time of writing
            spec.attribute("chromaticities", "float[8]", REC709)
            if wrap:
                spec.attribute("textureformat", "Plain Texture")
                spec.attribute("wrapmodes", wrap)
            if level:
                read = _averaging(read, (width >> level - 1, height >> level - 1), size, kind)
            _check(output, output.open(str(path), spec, "AppendMIPLevel" if level else "Create"))
            kept = stack.enter_context(TemporaryFile(dir=path.parent))
            for rows in strips(size[1]):
                pixels = np.array(read(rows), depth, order="C")  # its strides are checked
                area = (0, size[0], rows.start, rows.stop, 0, 1)
                _check(output, output.write_tiles(*area, pixels))
                if wrap:
                    kept.write(pixels.tobytes())
            kept.flush()
            read = partial(read_texels, kept, np.dtype((depth, (channels,))), size[0])
        _check(output, output.close())


def _averaging(
    larger: Callable[[slice], _Rows], above: tuple[int, int], size: tuple[int, int], kind: str
) -> Callable[[slice], _Rows]:
    """Rows of a level of this size (width, height), from those of the level `above`."""
    wide, high = max(above[0], 1), max(above[1], 1)

    def averaged(rows: slice) -> _Rows:
        down, from_row = _weights(rows, size[1], high)
        source = larger(from_row)
        parts = []
        for columns in strips(size[0]):
            across, from_column = _weights(columns, size[0], wide)
            planes = np.moveaxis(source[:, from_column], -1, 0)
            shrunk = [down @ plane.astype(np.float32, order="C") @ across.T for plane in planes]
            if kind == "normal":
                length = np.sqrt(sum(np.square(one) for one in shrunk))
                for one in shrunk:
                    one /= np.maximum(length, 1e-6)
            parts.append(np.stack(shrunk, axis=-1))
        return np.concatenate(parts, axis=1)

    return averaged


def _weights(wanted: slice, size: int, larger: int) -> tuple[NDArray[np.float32], slice]:
    """Box-filter weights along one axis.

    Args:
        wanted: texels of the smaller level.
        size: texels of the smaller level along the axis.
        larger: texels of the larger level along the axis.

    Returns:
        (wanted, source) weights, each row of sum 1, and the slice of source texels.
    """
    ratio = larger / size
    edges = np.arange(wanted.start, wanted.stop + 1) * ratio
    first, last = int(edges[0]), min(int(np.ceil(edges[-1])), larger)
    texels = np.arange(first, last)
    overlap = np.minimum(edges[1:, None], texels + 1) - np.maximum(edges[:-1, None], texels)
    shares = np.clip(overlap, 0.0, None) / ratio
    return (shares / shares.sum(axis=1, keepdims=True)).astype(np.float32), slice(first, last)


def height_coding(files: Sequence[Path]) -> tuple[float, float]:
    """(scale, midlevel) with height = (value - midlevel) scale and values from 0 to 1 over all."""
    ends = [(rows.min(), rows.max()) for file in files for _, rows in _stored(file)]
    return height_range(float(min(low for low, _ in ends)), float(max(high for _, high in ends)))


def write_png(file: Path, kind: str, heights: tuple[float, float]) -> None:
    """Write the PNG of a map beside its EXR file.

    Raises:
        OSError: the file cannot be written.
    """
    import OpenImageIO as oiio

    path = file.with_suffix(".png")
    opened: Any = oiio.ImageInput.open(str(file))
    source = opened.spec()
    opened.close()
    output: Any = oiio.ImageOutput.create(str(path))
    spec = oiio.ImageSpec(source.width, source.height, source.nchannels, "uint16")
    spec.attribute("oiio:ColorSpace", "sRGB" if kind == "diffuse" else "linear")
    spec.attribute("png:compressionLevel", 3)
    _check(output, output.open(str(path), spec))
    for rows, pixels in _stored(file):
        values = coded(kind, pixels, *heights)
        whole = np.rint(np.clip(values, 0.0, 1.0) * 65535.0).astype(np.uint16)
        _check(output, output.write_scanlines(rows.start, rows.stop, 0, whole))
    _check(output, output.close())


def strips(length: int) -> Iterator[slice]:
    """Slices of a tile's side that cover a length."""
    return (slice(at, min(at + _TILE, length)) for at in range(0, length, _TILE))


def _stored(file: Path) -> Iterator[tuple[slice, NDArray[np.float32]]]:
    """Strips of rows of an EXR file, each with its (rows, width, channels) values."""
    import OpenImageIO as oiio

    source: Any = oiio.ImageInput.open(str(file))
    spec = source.spec()
    for rows in strips(spec.height):
        area = (0, spec.width, rows.start, rows.stop, 0, 1)
        yield rows, source.read_tiles(0, 0, *area, 0, spec.nchannels, "float")
    source.close()


def _check(output: Any, done: bool) -> None:  # noqa: ANN401
    """Raise OSError if a step of writing failed."""
    if not done:
        text = output.geterror()
        raise OSError(errno.ENOSPC if "No space left" in text else errno.EIO, text)
