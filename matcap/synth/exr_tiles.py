"""Tiled OpenEXR files, written tile by tile ("OpenEXR File Layout", openexr.com).

A file is a header, a table of where every tile is, and the tiles, each of which says what it is.
Tiles are encoded apart from the file, so that many processes can do it, and come in any order. A
file that was cut off is read up to its last whole tile: that is how a run is resumed.

OpenEXR's own Python writer wants the whole picture at once, and OpenImageIO's cannot go on with a
file. Both read these files (tests/synth).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.exr import LARGEST_HALF
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
        """As stored."""
        return np.dtype("<f2" if self.half else "<f4")


@dataclass(frozen=True)
class Tile:
    """Column and row of a tile, and its level (0: full size)."""

    column: int
    row: int
    level: int = 0


@dataclass(frozen=True)
class Layout:
    """What a file looks like before any texel is in it."""

    width: int
    height: int
    """In texels."""
    channels: tuple[Channel, ...]
    """In alphabetical order of their names."""
    mipmap: bool = False
    """With all smaller levels, down to one texel."""
    wrap: str = ""
    """OpenImageIO's texture wrap modes, such as "periodic,black"; "" for none."""

    @property
    def levels(self) -> int:
        """How many levels there are."""
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
        """How many tiles there are on all levels."""
        return self.index(Tile(0, 0, self.levels))

    def index(self, tile: Tile) -> int:
        """The tile's place in the file's table."""
        before = [self.tiles(level) for level in range(tile.level)]
        return (
            sum(columns * rows for columns, rows in before)
            + tile.row * self.tiles(tile.level)[0]
            + tile.column
        )

    def area(self, tile: Tile) -> tuple[slice, slice]:
        """(rows, columns) of its level that a tile covers."""
        width, height = self.size(tile.level)
        x, y = tile.column * TILE, tile.row * TILE
        return slice(y, min(y + TILE, height)), slice(x, min(x + TILE, width))

    def shape(self, tile: Tile) -> tuple[int, int]:
        """(rows, columns): how many."""
        rows, columns = self.area(tile)
        return rows.stop - rows.start, columns.stop - columns.start

    def header(self) -> bytes:
        """Everything before the table."""
        window = struct.pack("<4i", 0, 0, self.width - 1, self.height - 1)
        listed = b"".join(
            channel.name.encode() + b"\0" + struct.pack("<iB3x2i", kind, 0, 1, 1)
            for channel in self.channels
            for kind in (_HALF if channel.half else _FLOAT,)
        )
        mode = _MIPMAP | _ROUND_DOWN << 4 if self.mipmap else 0
        attributes: list[tuple[str, str, bytes]] = [
            ("channels", "chlist", listed + b"\0"),
            ("chromaticities", "chromaticities", struct.pack("<8f", *REC709)),
            ("compression", "compression", bytes([_ZIP])),
            ("dataWindow", "box2i", window),
            ("displayWindow", "box2i", window),
            ("lineOrder", "lineOrder", bytes([_RANDOM_ORDER])),
            ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
            ("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
            ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
            ("tiles", "tiledesc", struct.pack("<2IB", TILE, TILE, mode)),
        ]
        if self.wrap:
            attributes.append(("textureformat", "string", b"Plain Texture"))
            attributes.append(("wrapmodes", "string", self.wrap.encode()))
        return (
            struct.pack("<2i", _MAGIC, _VERSION_TILED)
            + b"".join(
                name.encode()
                + b"\0"
                + kind.encode()
                + b"\0"
                + struct.pack("<i", len(value))
                + value
                for name, kind, value in attributes
            )
            + b"\0"
        )


def encode_tile(layout: Layout, tile: Tile, planes: Sequence[NDArray[np.generic]]) -> bytes:
    """A tile as it stands in the file.

    Args:
        layout: of the file.
        tile: which.
        planes: (rows, columns) of each channel, in the channels' types.
    """
    rows, columns = layout.shape(tile)
    raw = np.concatenate(
        [np.ascontiguousarray(p).view(np.uint8).reshape(rows, -1) for p in planes], axis=1
    ).ravel()
    # ZIP: even bytes before odd ones (high bytes are alike), differences, deflate. Runs and
    # Huffman codes only: matches cost twice the time and find little in what looks like noise.
    half = (raw.size + 1) // 2
    parted = np.empty_like(raw)
    parted[:half], parted[half:] = raw[::2], raw[1::2]
    differences = parted.copy()
    differences[1:] -= parted[:-1]
    differences[1:] += np.uint8(128)
    deflate = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    packed = deflate.compress(differences.tobytes()) + deflate.flush()
    data = packed if len(packed) < raw.size else raw.tobytes()
    return _CHUNK.pack(tile.column, tile.row, tile.level, tile.level, len(data)) + data


def decode_tile(layout: Layout, tile: Tile, data: bytes) -> list[NDArray[np.generic]]:
    """The inverse of encode_tile, without the chunk's five numbers before.

    Raises:
        ValueError: not what encode_tile writes.
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
        # Differences add up modulo 256; every one but the first has 128 too much.
        parted = np.cumsum(differences, dtype=np.uint8)
        parted[1::2] += np.uint8(128)
        half = (parted.size + 1) // 2
        raw = np.empty_like(parted)
        raw[::2], raw[1::2] = parted[:half], parted[half:]
    lines = raw.reshape(rows, -1)
    planes, start = [], 0
    for channel in layout.channels:
        stop = start + columns * channel.dtype.itemsize
        planes.append(np.ascontiguousarray(lines[:, start:stop]).view(channel.dtype))
        start = stop
    return planes


def stored(channel: Channel, values: NDArray[np.float32], name: str) -> NDArray[np.generic]:
    """Values in the channel's type.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
    """
    if not np.isfinite(values).all():
        raise MatcapError(
            "has values that are not finite", where=name, remedy="make the material again"
        )
    if channel.half and np.abs(values).max(initial=0.0) > LARGEST_HALF:
        raise MatcapError(
            "has values too large for half float (65504)",
            where=name,
            remedy="make the material again",
        )
    return values.astype(channel.dtype)


class TileFile:
    """A file that grows by one tile after the other, and may have been cut off.

    Args:
        stream: open for reading and writing; an empty one gets its header, another is read up to
            its last whole tile.
        layout: of the file.
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
        """How many tiles are there."""
        return int(np.count_nonzero(self._places))

    def append(self, tile: Tile, chunk: bytes) -> None:
        """Add a tile, as encode_tile gave it."""
        self._stream.seek(self._end)
        self._stream.write(chunk)
        self._places[self.layout.index(tile)] = self._end
        self._end += len(chunk)

    def read(self, tile: Tile) -> list[NDArray[np.generic]]:
        """The planes of a tile that is there and flushed; from any thread."""
        place = int(self._places[self.layout.index(tile)])
        *_, size = _CHUNK.unpack(os.pread(self._stream.fileno(), _CHUNK.size, place))
        data = os.pread(self._stream.fileno(), size, place + _CHUNK.size)
        return decode_tile(self.layout, tile, data)

    def flush(self) -> None:
        """Let what was appended be read."""
        self._stream.flush()

    def finish(self) -> None:
        """Write the table: from here on the file is one that other programs read."""
        if self.written != self.layout.count:
            raise ValueError(f"{self.layout.count - self.written} tiles are missing")
        self._stream.seek(self._table)
        self._stream.write(self._places.tobytes())
        self._stream.flush()

    def _recover(self) -> None:
        """Find the whole tiles of a file that was cut off; the first broken one ends it."""
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
