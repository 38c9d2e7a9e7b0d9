"""From a block's maps to tiles of the files they are stored in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.heights import check_heights
from matcap.brdf.stated import NormalStyle
from matcap.field.blocks import Piece
from matcap.synth.exr_tiles import TILE, Channel, Layout, Tile, encode_tile, stored

if TYPE_CHECKING:
    from matcap.field.source import Source

# Every stored map's channels, as they are called in a file of their own and in one of all maps.
_OWN = {"diffuse": "RGB", "specular": "Y", "roughness": "Y", "height": "Y", "normal": "RGB"}
_JOINED = _OWN | {"height": "Z", "normal": "XYZ"}

# Where each map lies among the nine planes.
KIND_PLANES = {
    "diffuse": (0, 1, 2),
    "specular": (3,),
    "roughness": (4,),
    "height": (5,),
    "normal": (6, 7, 8),
}
NORMAL_PLANES = KIND_PLANES["normal"]


@dataclass(frozen=True)
class PictureFile:
    """One file.

    Attributes:
        file: its name.
        layout: of its tiles.
        planes: for each channel of the layout, which of the nine stored planes it holds.
    """

    file: str
    layout: Layout
    planes: tuple[int, ...]


@dataclass(frozen=True)
class Fragment:
    """A part of a tile that reaches beyond a piece.

    Attributes:
        tile: which.
        place: (rows, columns) of the tile.
        planes: of each channel.
    """

    tile: Tile
    place: tuple[slice, slice]
    planes: list[NDArray[np.generic]]


@dataclass(frozen=True)
class Rendered:
    """What a piece gives to one picture: whole tiles, encoded, and parts of others."""

    tiles: list[tuple[Tile, bytes]]
    fragments: list[Fragment]


def pictures_of(
    name: str, size: tuple[int, int], *, single: bool, mipmap: bool, wrap: str
) -> tuple[PictureFile, ...]:
    """The files of a map set.

    Args:
        name: what they begin with; `{kind}` in it stands for the map's name.
        size: (width, height) in texels.
        single: all maps in one file.
        mipmap, wrap: of the layout.
    """
    places: dict[str, list[tuple[str, int, bool]]] = {}
    for kind, planes in KIND_PLANES.items():
        file = name.replace("{kind}", "maps" if single else kind) + ".exr"
        for channel, plane in zip(channels_of(kind, single=single), planes, strict=True):
            places.setdefault(file, []).append((channel, plane, kind != "height"))
    return tuple(
        PictureFile(
            file,
            Layout(*size, tuple(Channel(c, half) for c, _, half in sorted(found)), mipmap, wrap),
            tuple(plane for _, plane, _ in sorted(found)),
        )
        for file, found in places.items()
    )


def channels_of(kind: str, *, single: bool) -> tuple[str, ...]:
    """A map's channels as its file calls them."""
    return tuple(f"{kind}.{letter}" for letter in _JOINED[kind]) if single else tuple(_OWN[kind])


def render(
    source: Source, piece: Piece, pictures: Sequence[PictureFile], normal: NormalStyle
) -> list[Rendered]:
    """Compute a piece and encode what of it makes whole tiles, for each picture.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
    """
    wanted = source.planes(piece.block, normal)[(..., *piece.source)]
    check_heights(wanted[KIND_PLANES["height"][0]], "the material")
    return [_render(picture, piece, wanted) for picture in pictures]


def _render(picture: PictureFile, piece: Piece, planes: NDArray[np.float32]) -> Rendered:
    layout, (rows, columns) = picture.layout, piece.target
    values = [
        stored(channel, planes[plane], picture.file)
        for channel, plane in zip(layout.channels, picture.planes, strict=True)
    ]
    tiles, fragments = [], []
    for tile in tiles_of(piece):
        area = layout.area(tile)
        inner = tuple(
            slice(max(a.start, b.start), min(a.stop, b.stop))
            for a, b in zip(area, (rows, columns), strict=True)
        )
        y, x = (
            slice(i.start - t.start, i.stop - t.start)
            for i, t in zip(inner, piece.target, strict=True)
        )
        cut = [plane[y, x] for plane in values]
        if inner == area:
            tiles.append((tile, encode_tile(layout, tile, cut)))
        else:
            y, x = (
                slice(i.start - a.start, i.stop - a.start) for i, a in zip(inner, area, strict=True)
            )
            fragments.append(Fragment(tile, (y, x), cut))
    return Rendered(tiles, fragments)


def tiles_of(piece: Piece) -> Iterator[Tile]:
    """All tiles that a piece has a part in, row by row."""
    rows, columns = piece.target
    for row in range(rows.start // TILE, (rows.stop - 1) // TILE + 1):
        for column in range(columns.start // TILE, (columns.stop - 1) // TILE + 1):
            yield Tile(column, row)
