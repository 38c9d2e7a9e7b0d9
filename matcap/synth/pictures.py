"""Files of a map set: their encoding, their assembly from blocks, the preview."""

from __future__ import annotations

import errno
import math
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.edited import check_heights
from matcap.brdf.folder import coded, height_range
from matcap.field.plane import BlockPart, Rectangle
from matcap.files.color import REC709, srgb_picture
from matcap.files.exr import check_representable
from matcap.files.pixels import png_bytes, quantised

if TYPE_CHECKING:
    from matcap.brdf.stated import NormalStyle
    from matcap.field.plane import Period


# Computed texels of one map set, in a file of plain numbers, until all are there.
#
# Parts arrive in any order. A second file lists those that are complete, with the checksum of their
# bytes, so that an interrupted run is resumed: a part whose bytes a power cut took is computed
# again.

_PART = struct.Struct("<QI")  # index of a part, and checksum
_WRITTEN = 2**64 - 1  # index that says that the map set's files are written


class Assembly:
    """The texels of a map set.

    Args:
        path: of the file, new or as an interrupted run left it; the list of parts has the suffix
            .parts.
        size: (width, height) in texels.
        kind: type of a texel.
    """

    def __init__(self, path: Path, size: tuple[int, int], kind: np.dtype[np.void]) -> None:
        self.size, self.kind = size, kind
        parts = path.with_suffix(".parts")
        known = parts.read_bytes() if parts.exists() else b""
        known = known[: len(known) // _PART.size * _PART.size]
        self._parts = dict(_PART.iter_unpack(known))
        self._list = parts.open("wb")
        self._list.write(known)
        self._path = path
        path.touch()
        self._file = path.open("r+b")

    @property
    def written(self) -> bool:
        """Whether the map set's files are written, and its texels are gone."""
        return _WRITTEN in self._parts

    def has(self, index: int, part: BlockPart) -> bool:
        """Whether a part is complete; `index` is its place in the order of all."""
        if self.written:
            return True
        if index not in self._parts:
            return False
        rows, columns = part.target
        length = (columns.stop - columns.start) * self.kind.itemsize
        lines = (
            os.pread(self._file.fileno(), length, self._place(row, columns))
            for row in range(rows.start, rows.stop)
        )
        return crc32(b"".join(lines)) == self._parts[index]

    def add(self, index: int, part: BlockPart, texels: NDArray[np.void]) -> None:
        """Store the (rows, columns) texels of a part."""
        if self.written:
            return
        rows, columns = part.target
        for row, line in zip(range(rows.start, rows.stop), texels, strict=True):
            self._file.seek(self._place(row, columns))
            self._file.write(line.tobytes())
        self._file.flush()
        self._note(index, crc32(texels.tobytes()))

    def rows(self, rows: slice) -> NDArray[np.void]:
        """(rows, width) texels; thread-safe."""
        return read_texels(self._file, self.kind, self.size[0], rows)

    def finish(self) -> None:
        """Drop the texels, once the map set's files are written."""
        if not self.written:
            self._note(_WRITTEN, 0)
        self.close()
        self._path.unlink()

    def close(self) -> None:
        """Close both files."""
        self._list.close()
        self._file.close()

    def _place(self, row: int, columns: slice) -> int:
        """Offset in the file of a row's columns."""
        return (row * self.size[0] + columns.start) * self.kind.itemsize

    def _note(self, index: int, checksum: int) -> None:
        self._list.write(_PART.pack(index, checksum))
        self._list.flush()


def read_texels(file: IO[bytes], kind: np.dtype[Any], width: int, rows: slice) -> NDArray[Any]:
    """(rows, width) texels of a file of plain numbers; thread-safe."""
    length = width * kind.itemsize
    data = os.pread(file.fileno(), (rows.stop - rows.start) * length, rows.start * length)
    data += bytes((rows.stop - rows.start) * length - len(data))  # not written yet
    return np.frombuffer(data, kind.base).reshape(-1, width, *kind.shape)


# Files of a map set: tiled EXR, with mip levels on request, and 16-bit PNGs.
#
# Written by OpenImageIO in strips of rows, from the computed texels. Maps are half
# floats, heights 32-bit floats. A mip level is the box average of the next larger one; normals are
# normalised, and roughness takes up the variance of slopes that is lost, as in relight/texture.py
# [olano2010]: alpha^2 + E[s^2] - E[s]^2. PNGs hold the values of the EXR files.

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

    rough = kind == "roughness" and bool(wrap)
    read: Callable[[slice], _Rows] = partial(_moments, texels) if rough else whole
    store = np.dtype((np.float32 if rough else depth, (4 if rough else channels,)))
    levels = max(width, height).bit_length() if wrap else 1
    with ExitStack() as stack:
        output: Any = oiio.ImageOutput.create(str(path))
        for level in range(levels):
            size = max(width >> level, 1), max(height >> level, 1)
            spec = oiio.ImageSpec(*size, channels, "half" if depth.itemsize == 2 else "float")
            spec.channelnames = tuple("RGB" if channels == 3 else "Y")
            spec.tile_width = spec.tile_height = _TILE
            spec.attribute("compression", "zip:1")  # 2 % larger than the default, a third faster
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
                values = pixels = np.array(read(rows), store.base, order="C")  # strides are checked
                if rough:
                    pixels = np.array(_roughness(values) if level else whole(rows), depth)
                area = (0, size[0], rows.start, rows.stop, 0, 1)
                _check(output, output.write_tiles(*area, pixels))
                if wrap:
                    kept.write(values.tobytes())
            kept.flush()
            read = partial(read_texels, kept, store, size[0])
        _check(output, output.close())


def _moments(texels: Assembly, rows: slice) -> _Rows:
    """(rows, width, 4) alpha^2, slopes along x and y, and their squares' sum."""
    values = texels.rows(rows)
    normal = values["normal"].astype(np.float32)
    slopes = normal[..., :2] / np.maximum(normal[..., 2:], np.float32(1e-3))
    squares = np.square(slopes).sum(axis=-1, keepdims=True)
    alpha2 = values["roughness"].astype(np.float32) ** 4
    return np.concatenate([alpha2, slopes, squares], axis=-1)


def _roughness(moments: _Rows) -> _Rows:
    """(rows, width, 1) roughness of a lobe that is as wide as those in a texel of _moments."""
    lost = moments[..., 3:] - np.square(moments[..., 1:3]).sum(axis=-1, keepdims=True)
    return np.asarray((moments[..., :1] + np.maximum(lost, 0.0)).clip(0.0, 1.0) ** 0.25)


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


# NAME_preview.png: about a megapixel of a map set or texture set, lit from the top.
#
# One pixel a texel, of the middle; where the field repeats, of where its copies meet, with the
# seam's place marked outside the picture. Workers light the parts as they compute them, so that
# nothing is read back; a resumed run computes the parts that the preview shows again.

_PIXELS, _SIDE = 1 << 20, 1024  # of the picture; one side is longer if the other is shorter
# Dark materials are multiplied until this quantile of the radiance has this value.
_BRIGHT_SHARE, _BRIGHT, _LARGEST_GAIN = 0.99, 0.5, 4.0
_MARGIN, _PAPER, _INK = 16, 24, (240, 180, 41)  # pixels around what repeats; sRGB code values

# Rows and columns of the picture, and of the part that is shown there.
_Place = tuple[tuple[slice, slice], tuple[slice, slice]]


@dataclass(frozen=True)
class Preview:
    """The rectangle that a preview shows."""

    whole: Rectangle
    """The map set or texture set."""
    shown: Rectangle
    """Texels of the field; beyond `whole` along axes that repeat."""
    repeats: tuple[bool, bool]
    """Whether the field repeats with the whole's sides, along x and y."""

    def places(self, area: Rectangle, part: BlockPart) -> list[_Place]:
        """Where a part of a map set of this area is shown; empty if it is not."""
        rows, columns = part.target
        down = list(self._along(1, area.y + rows.start, rows.stop - rows.start))
        across = list(self._along(0, area.x + columns.start, columns.stop - columns.start))
        return [((y, x), (row, column)) for y, row in down for x, column in across]

    def _along(self, axis: int, start: int, length: int) -> Iterator[tuple[slice, slice]]:
        """Slices of the picture and of `length` texels from `start`, along x (0) or y (1)."""
        shown, whole = (
            ((one.x, one.width), (one.y, one.height))[axis] for one in (self.shown, self.whole)
        )
        for turn in range(-1, 2) if self.repeats[axis] else (0,):
            first = start + turn * whole[1] - shown[0]
            low, high = max(first, 0), min(first + length, shown[1])
            if low < high:
                yield slice(low, high), slice(low - first, high - first)


def preview_of(whole: Rectangle, period: Period | None) -> Preview:
    """The preview of a map set or texture set, of a field with this period."""
    across, down = period or (None, None)
    repeats = (across == whole.width, down == whole.height)
    # Of what repeats up to two copies, which meet in the middle.
    width, height = (
        min(2 * side, _SIDE) if repeat else side
        for side, repeat in zip((whole.width, whole.height), repeats, strict=True)
    )
    width = min(width, max(_SIDE, _PIXELS // height))
    height = min(height, max(_SIDE, _PIXELS // width))
    x, y = (
        start - shown // 2 if repeat else start + (side - shown) // 2
        for start, side, shown, repeat in zip(
            (whole.x, whole.y), (whole.width, whole.height), (width, height), repeats, strict=True
        )
    )
    return Preview(whole, Rectangle(x, y, width, height), repeats)


def lit_from_top(planes: NDArray[np.float32], normal: NormalStyle) -> NDArray[np.float16]:
    """(H, W, 3) radiance, at most 1, of a block's planes (Source.planes); a white diffuser has 1.

    The light is that of `relight --light top`, at infinite distance.
    """
    from matcap.relight.scene import NAMED_LIGHTS, DirectionalLight, exposing_intensity
    from matcap.relight.texture import light_texels

    place = NAMED_LIGHTS["top"]
    irradiance = exposing_intensity(place) / math.dist(place, (0.0, 0.0, 0.0)) ** 2
    maps = {kind: planes[list(at)] for kind, at in kind_planes(len(planes) - 8).items()}
    if normal == "dx":
        maps["normal"][1] *= -1.0
    del maps["height"]
    radiance = light_texels(**maps, light=DirectionalLight(place, (irradiance,) * 3))
    return np.moveaxis(np.clip(radiance, 0.0, 1.0), 0, -1).astype(np.float16)


class PreviewPicture:
    """Joins the lit parts of a preview."""

    def __init__(self, preview: Preview) -> None:
        self._preview = preview
        self._radiance = np.zeros((preview.shown.height, preview.shown.width, 3), np.float16)

    def add(self, area: Rectangle, part: BlockPart, lit: NDArray[np.float16]) -> None:
        """Copy a part (rows, columns, 3) of a map set of this area to where it is shown."""
        for place, source in self._preview.places(area, part):
            self._radiance[place] = lit[source]

    def encoded(self) -> bytes:
        """The picture as PNG, with the seams marked; dark materials are brightened."""
        bright = float(np.quantile(self._radiance[::8, ::8].astype(np.float32), _BRIGHT_SHARE))
        gain = min(max(_BRIGHT / max(bright, 1e-6), 1.0), _LARGEST_GAIN)
        # Of all half floats up to 1, which are the first in the order of their bits.
        known = np.arange(0x3C01, dtype=np.uint16).view(np.float16).astype(np.float32)
        codes = quantised(srgb_picture(known * gain), bits=8)[self._radiance.view(np.uint16)]
        return png_bytes(_marked(codes, self._preview.repeats))


def _marked(pixels: NDArray[Any], repeats: tuple[bool, bool]) -> NDArray[Any]:
    """The picture in a margin, with wedges that point to the seams in its middle."""
    if not any(repeats):
        return pixels
    sides = ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, 0))
    sheet = np.pad(pixels, sides, constant_values=_PAPER)
    wedge = np.abs(np.arange(-_MARGIN, _MARGIN) + 0.5) < np.arange(_MARGIN)[:, None]
    for axis in (axis for axis, repeat in enumerate(repeats) if repeat):
        along = np.swapaxes(sheet, 0, axis)  # the seam's line is a column of it
        middle = along.shape[1] // 2
        line = along[:, middle - _MARGIN : middle + _MARGIN]
        line[_MARGIN - 1 :: -1][wedge] = _INK
        line[-_MARGIN:][wedge] = _INK
    return sheet
