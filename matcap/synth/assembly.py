"""Computed texels of one map set, in a file of plain numbers, until all are there.

Parts arrive in any order. A second file lists those that are complete, with the checksum of their
bytes, so that an interrupted run is resumed: a part whose bytes a power cut took is computed again.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import IO, Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from matcap.field.blocks import BlockPart

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
