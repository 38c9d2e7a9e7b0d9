"""Tiled OpenEXR files, written tile by tile ("OpenEXR File Layout", openexr.com).

A file is a header, a table of tile offsets, and the tiles, each with its coordinates. Tiles are
encoded independently of the file, in several processes, and appended in any order. A truncated file
is read up to its last whole tile, so that an interrupted run can be resumed.

OpenEXR's Python writer needs the whole picture at once, and OpenImageIO's cannot resume a file.
Both read these files (tests/synth).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from matcap.files.exr import check_representable
from matcap.files.rec709 import REC709

TILE = 64
_MAGIC, _VERSION_TILED = 20000630, 2 | 0x200
_ZIP, _RANDOM_ORDER, _MIPMAP, _ROUND_DOWN = 3, 2, 1, 0
_HALF, _FLOAT = 1, 2
_CHUNK = struct.Struct("<5i")  # tile x and y, level x and y, bytes of data


@dataclass(frozen=True)
class Channel:
    """A channel of a file: its name, and half or 32-bit float."""

    name: str
    half: bool

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """NumPy type of the stored values."""
        return np.dtype("<f2" if self.half else "<f4")


# Rows and columns of a level, or of an array.
Area = tuple[slice, slice]


def intersection(one: Area, other: Area) -> Area:
    """The rows and columns of both."""
    rows, columns = (
        slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(one, other, strict=True)
    )
    return rows, columns


def relative(area: Area, outer: Area) -> Area:
    """Rows and columns of an area in an array that covers `outer`."""
    rows, columns = (
        slice(a.start - b.start, a.stop - b.start) for a, b in zip(area, outer, strict=True)
    )
    return rows, columns


@dataclass(frozen=True)
class Tile:
    """Column and row of a tile, and its level (0: full size)."""

    column: int
    row: int
    level: int = 0


@dataclass(frozen=True)
class Layout:
    """Size, channels and options of a file."""

    width: int
    height: int
    """Sides in texels."""
    channels: tuple[Channel, ...]
    """Channels in alphabetical order of their names."""
    mipmap: bool = False
    """Whether the file has all mip levels, down to one texel."""
    wrap: str = ""
    """OpenImageIO's texture wrap modes, such as "periodic,black"; "" for none."""

    @property
    def levels(self) -> int:
        """Number of mip levels, 1 without mipmap."""
        return max(self.width, self.height).bit_length() if self.mipmap else 1

    def size(self, level: int) -> tuple[int, int]:
        """(width, height) of a level, rounded down."""
        return max(self.width >> level, 1), max(self.height >> level, 1)

    def tiles(self, level: int) -> tuple[int, int]:
        """(columns, rows) of tiles of a level."""
        width, height = self.size(level)
        return -(-width // TILE), -(-height // TILE)

    @property
    def count(self) -> int:
        """Number of tiles on all levels."""
        return self.index(Tile(0, 0, self.levels))

    def index(self, tile: Tile) -> int:
        """The tile's index in the offset table."""
        before = [self.tiles(level) for level in range(tile.level)]
        return (
            sum(columns * rows for columns, rows in before)
            + tile.row * self.tiles(tile.level)[0]
            + tile.column
        )

    def area(self, tile: Tile) -> Area:
        """(rows, columns) of its level that a tile covers."""
        width, height = self.size(tile.level)
        x, y = tile.column * TILE, tile.row * TILE
        return slice(y, min(y + TILE, height)), slice(x, min(x + TILE, width))

    def shape(self, tile: Tile) -> tuple[int, int]:
        """(rows, columns) of texels in a tile; less than TILE at the right and lower border."""
        rows, columns = self.area(tile)
        return rows.stop - rows.start, columns.stop - columns.start

    def header(self) -> bytes:
        """The bytes before the offset table."""
        window = struct.pack("<4i", 0, 0, self.width - 1, self.height - 1)
        listed = b"".join(
            channel.name.encode() + b"\0" + struct.pack("<iB3x2i", kind, 0, 1, 1)
            for channel in self.channels
            for kind in (_HALF if channel.half else _FLOAT,)
        )
        mode = _MIPMAP | _ROUND_DOWN << 4 if self.mipmap else 0
        attributes = [
            (b"channels", b"chlist", listed + b"\0"),
            (b"chromaticities", b"chromaticities", struct.pack("<8f", *REC709)),
            (b"compression", b"compression", bytes([_ZIP])),
            (b"dataWindow", b"box2i", window),
            (b"displayWindow", b"box2i", window),
            (b"lineOrder", b"lineOrder", bytes([_RANDOM_ORDER])),
            (b"pixelAspectRatio", b"float", struct.pack("<f", 1.0)),
            (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0.0, 0.0)),
            (b"screenWindowWidth", b"float", struct.pack("<f", 1.0)),
            (b"tiles", b"tiledesc", struct.pack("<2IB", TILE, TILE, mode)),
        ]
        if self.wrap:
            attributes.append((b"textureformat", b"string", b"Plain Texture"))
            attributes.append((b"wrapmodes", b"string", self.wrap.encode()))
        written = (
            b"%b\0%b\0%b%b" % (name, kind, struct.pack("<i", len(value)), value)
            for name, kind, value in attributes
        )
        return struct.pack("<2i", _MAGIC, _VERSION_TILED) + b"".join(written) + b"\0"


def tiles_over(area: Area, level: int = 0) -> Iterator[Tile]:
    """The tiles of a level that an area overlaps, row by row."""
    rows, columns = area
    for row in range(rows.start // TILE, (rows.stop - 1) // TILE + 1):
        for column in range(columns.start // TILE, (columns.stop - 1) // TILE + 1):
            yield Tile(column, row, level)


def encode_tile(layout: Layout, tile: Tile, planes: Sequence[NDArray[np.generic]]) -> bytes:
    """Encode a tile's chunk: coordinates, size and ZIP-compressed data.

    Args:
        planes: (rows, columns) of each channel, in the channels' types.
    """
    rows, columns = layout.shape(tile)
    raw = np.concatenate(
        [np.ascontiguousarray(p).view(np.uint8).reshape(rows, -1) for p in planes], axis=1
    ).ravel()
    # ZIP: even bytes, then odd bytes (high bytes are alike), differences, deflate. Z_RLE omits
    # string matching, which takes twice the time and gains little on textures.
    half = (raw.size + 1) // 2
    split = np.empty_like(raw)
    split[:half], split[half:] = raw[::2], raw[1::2]
    differences = split.copy()
    differences[1:] -= split[:-1]
    differences[1:] += np.uint8(128)
    deflate = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    packed = deflate.compress(differences.tobytes()) + deflate.flush()
    data = packed if len(packed) < raw.size else raw.tobytes()
    return _CHUNK.pack(tile.column, tile.row, tile.level, tile.level, len(data)) + data


def decode_tile(layout: Layout, tile: Tile, data: bytes) -> list[NDArray[np.generic]]:
    """Inverse of encode_tile, given the data after the chunk's five integers.

    Raises:
        ValueError: the data are not of this tile.
    """
    rows, columns = layout.shape(tile)
    bytes_wanted = rows * columns * sum(channel.dtype.itemsize for channel in layout.channels)
    if len(data) == bytes_wanted:
        raw = np.frombuffer(data, np.uint8)
    else:
        try:
            differences = np.frombuffer(zlib.decompress(data), np.uint8)
        except zlib.error as error:
            raise ValueError(str(error)) from error
        if differences.size != bytes_wanted:
            raise ValueError(f"{differences.size} bytes instead of {bytes_wanted}")
        # Sums modulo 256; each difference but the first is stored with 128 added.
        split = np.cumsum(differences, dtype=np.uint8)
        split[1::2] += np.uint8(128)
        half = (split.size + 1) // 2
        raw = np.empty_like(split)
        raw[::2], raw[1::2] = split[:half], split[half:]
    lines = raw.reshape(rows, -1)
    planes, start = [], 0
    for channel in layout.channels:
        stop = start + columns * channel.dtype.itemsize
        planes.append(np.ascontiguousarray(lines[:, start:stop]).view(channel.dtype))
        start = stop
    return planes


def stored(channel: Channel, values: NDArray[np.float32], name: str) -> NDArray[np.generic]:
    """Convert values to the channel's type; `name` is the file that errors name.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
    """
    check_representable(name, values, half=channel.half)
    return values.astype(channel.dtype)


class TileFile:
    """A file to which tiles are appended.

    Args:
        stream: open for reading and writing; whole tiles of an earlier run are kept, an incomplete
            last one is dropped.
    """

    def __init__(self, stream: BinaryIO, layout: Layout) -> None:
        self._stream = stream
        self.layout = layout
        header = layout.header()
        self._table = len(header)
        self._end = self._table + 8 * layout.count
        self._places = np.zeros(layout.count, dtype="<u8")
        stream.seek(0)
        if stream.read(len(header)) == header:
            self._recover()
        stream.seek(0)
        stream.write(header)
        stream.truncate(self._end)
        stream.seek(self._end)

    def __contains__(self, tile: Tile) -> bool:
        return bool(self._places[self.layout.index(tile)])

    @property
    def written(self) -> int:
        """Number of tiles in the file."""
        return int(np.count_nonzero(self._places))

    def append(self, tile: Tile, chunk: bytes) -> None:
        """Append a tile's chunk from encode_tile."""
        self._stream.seek(self._end)
        self._stream.write(chunk)
        self._places[self.layout.index(tile)] = self._end
        self._end += len(chunk)

    def read(self, tile: Tile) -> list[NDArray[np.generic]]:
        """Read the planes of a tile that was appended and flushed; thread-safe."""
        place = int(self._places[self.layout.index(tile)])
        *_, size = _CHUNK.unpack(os.pread(self._stream.fileno(), _CHUNK.size, place))
        data = os.pread(self._stream.fileno(), size, place + _CHUNK.size)
        return decode_tile(self.layout, tile, data)

    def flush(self) -> None:
        """Flush, so that appended tiles can be read."""
        self._stream.flush()

    def finish(self) -> None:
        """Write the offset table, which makes the file readable by other programs."""
        if self.written != self.layout.count:
            raise ValueError(f"{self.layout.count - self.written} tiles are missing")
        self._stream.seek(self._table)
        self._stream.write(self._places.tobytes())
        self._stream.flush()

    def _recover(self) -> None:
        """Register the tiles of a truncated file, up to the first one that is incomplete."""
        self._stream.seek(self._end)
        while len(numbers := self._stream.read(_CHUNK.size)) == _CHUNK.size:
            column, row, level, _, size = _CHUNK.unpack(numbers)
            tile = Tile(column, row, level)
            if not 0 <= level < self.layout.levels:
                return
            columns, rows = self.layout.tiles(level)
            if not (0 <= column < columns and 0 <= row < rows and size > 0):
                return
            try:
                decode_tile(self.layout, tile, self._stream.read(size))
            except ValueError:
                return
            self._places[self.layout.index(tile)] = self._end
            self._end += _CHUNK.size + size
