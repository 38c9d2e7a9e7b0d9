"""The files of one map set while they grow."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.field.blocks import BlockPart
from matcap.synth.exr_tiles import Tile, TileFile, encode_tile
from matcap.synth.pictures import Fragment, PictureFile, Rendered, tiles_of


class Assembly:
    """Puts rendered pieces into files, joining the tiles that several pieces have a part in.

    Args:
        pictures: what is written.
        files: where to, one for each picture; tiles that are there already stay.
    """

    def __init__(self, pictures: Sequence[PictureFile], files: Sequence[TileFile]) -> None:
        self.pictures = pictures
        self.files = files
        self._started: list[dict[Tile, _Started]] = [{} for _ in files]

    def lacks(self, piece: BlockPart) -> bool:
        """Whether a tile is missing that the piece has a part in."""
        return any(tile not in file for tile in tiles_of(piece) for file in self.files)

    def add(self, rendered: Sequence[Rendered]) -> None:
        """Write what a piece gave to every picture."""
        for file, started, one in zip(self.files, self._started, rendered, strict=True):
            for tile, chunk in one.tiles:
                if tile not in file:
                    file.append(tile, chunk)
            for fragment in one.fragments:
                tile = fragment.tile
                if tile in file:
                    continue
                whole = started.setdefault(tile, _Started(file, tile))
                if whole.fill(fragment):
                    file.append(tile, encode_tile(file.layout, tile, whole.planes))
                    del started[tile]


class _Started:
    """A tile of which some parts are there."""

    def __init__(self, file: TileFile, tile: Tile) -> None:
        shape = file.layout.shape(tile)
        self._missing = shape[0] * shape[1]
        self.planes: list[NDArray[np.generic]] = [
            np.empty(shape, channel.dtype) for channel in file.layout.channels
        ]

    def fill(self, fragment: Fragment) -> bool:
        """Take in a part; True when it was the last one."""
        for plane, part in zip(self.planes, fragment.planes, strict=True):
            plane[fragment.place] = part
        self._missing -= fragment.planes[0].size
        return self._missing == 0


@contextmanager
def assembly(stage: Path, pictures: Sequence[PictureFile]) -> Iterator[Assembly]:
    """The files of some pictures in a folder, new or as an earlier run left them."""
    with ExitStack() as stack:
        files = []
        for picture in pictures:
            path = stage / picture.file
            path.touch()
            files.append(TileFile(stack.enter_context(path.open("r+b")), picture.layout))
        yield Assembly(pictures, files)
