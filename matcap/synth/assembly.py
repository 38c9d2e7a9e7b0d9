"""Assembles the tiled files of one map set from rendered parts of blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.field.blocks import BlockPart
from matcap.synth.exr_tiles import Tile, TileFile, encode_tile, tiles_over
from matcap.synth.pictures import Fragment, PictureFile, Rendered


class Assembly:
    """Writes rendered parts to files; joins the fragments of tiles that several blocks overlap.

    Args:
        files: one for each picture; tiles that a file already has are kept.
    """

    def __init__(self, pictures: Sequence[PictureFile], files: Sequence[TileFile]) -> None:
        self.pictures = pictures
        self.files = files
        self._started: list[dict[Tile, _Started]] = [{} for _ in files]

    def lacks(self, part: BlockPart) -> bool:
        """Whether any file lacks a tile that the part overlaps."""
        return any(tile not in file for tile in tiles_over(part.target) for file in self.files)

    def add(self, rendered: Sequence[Rendered]) -> None:
        """Write the tiles of a rendered part, one Rendered for each picture."""
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
    """A tile of which some fragments have arrived."""

    def __init__(self, file: TileFile, tile: Tile) -> None:
        shape = file.layout.shape(tile)
        self._missing = shape[0] * shape[1]
        self.planes: list[NDArray[np.generic]] = [
            np.empty(shape, channel.dtype) for channel in file.layout.channels
        ]

    def fill(self, fragment: Fragment) -> bool:
        """Copy a fragment into the tile; return whether the tile is complete."""
        for plane, values in zip(self.planes, fragment.planes, strict=True):
            plane[fragment.place] = values
        self._missing -= fragment.planes[0].size
        return self._missing == 0


@contextmanager
def assembly(stage: Path, pictures: Sequence[PictureFile]) -> Iterator[Assembly]:
    """Open the pictures' files in a folder, new or as an interrupted run left them."""
    with ExitStack() as stack:
        files = []
        for picture in pictures:
            path = stage / picture.file
            path.touch()
            files.append(TileFile(stack.enter_context(path.open("r+b")), picture.layout))
        yield Assembly(pictures, files)
