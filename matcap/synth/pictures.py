"""Files of a map set, and the encoding of a block's maps as their tiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.heights import check_heights
from matcap.field.blocks import BlockPart
from matcap.synth.exr_tiles import (
    Area,
    Channel,
    Layout,
    Tile,
    encode_tile,
    intersection,
    relative,
    stored,
    tiles_over,
)

# Channel names of each map, in a file of its own and in one file of all maps. An F0 with a colour
# has those of diffuse.
_OWN = {"diffuse": "RGB", "specular": "Y", "roughness": "Y", "height": "Y", "normal": "RGB"}
_JOINED = _OWN | {"height": "Z", "normal": "XYZ"}
_COLOUR = ("specular", 3)


def kind_planes(specular: int) -> dict[str, tuple[int, ...]]:
    """Indices of each map's planes among the stored planes, for a number of channels of F0."""
    counts = {"diffuse": 3, "specular": specular, "roughness": 1, "height": 1, "normal": 3}
    ends = accumulate(counts.values())
    return {
        kind: tuple(range(end - count, end))
        for (kind, count), end in zip(counts.items(), ends, strict=True)
    }


@dataclass(frozen=True)
class PictureFile:
    """A file of a map set."""

    file: str
    """File name."""
    layout: Layout
    planes: tuple[int, ...]
    """For each channel of the layout, the index of the stored plane."""
    kinds: tuple[str, ...]
    """For each channel of the layout, the name of its map."""

    def places(self, kind: str) -> list[int]:
        """Indices of a map's channels in the layout, in the map's own order."""
        own = [place for place, stored in enumerate(self.kinds) if stored == kind]
        return sorted(own, key=lambda place: self.planes[place])


@dataclass(frozen=True)
class Fragment:
    """The part of a tile that one block covers."""

    tile: Tile
    place: Area
    """Rows and columns within the tile."""
    planes: list[NDArray[np.generic]]
    """Values of each channel."""


@dataclass(frozen=True)
class Rendered:
    """One block's contribution to one picture: whole tiles, encoded, and fragments of others."""

    tiles: list[tuple[Tile, bytes]]
    fragments: list[Fragment]


def pictures_of(
    name: str, size: tuple[int, int], *, specular: int, single: bool, mipmap: bool, wrap: str
) -> tuple[PictureFile, ...]:
    """The files of a map set.

    Args:
        name: prefix of the file names; `{kind}` is replaced by the map's name.
        size: (width, height) in texels.
        specular: channels of F0.
        single: all maps in one file.
        mipmap, wrap: see Layout.
    """
    places: dict[str, list[tuple[str, int, str]]] = {}
    for kind, planes in kind_planes(specular).items():
        file = name.replace("{kind}", "maps" if single else kind) + ".exr"
        channels = channels_of(kind, specular=specular, single=single)
        for channel, plane in zip(channels, planes, strict=True):
            places.setdefault(file, []).append((channel, plane, kind))
    return tuple(
        PictureFile(
            file,
            Layout(
                *size, tuple(Channel(c, kind != "height") for c, _, kind in sorted(channels_at)),
                mipmap, wrap,
            ),
            tuple(plane for _, plane, _ in sorted(channels_at)),
            tuple(kind for _, _, kind in sorted(channels_at)),
        )
        for file, channels_at in places.items()
    )  # fmt: skip


def channels_of(kind: str, *, specular: int, single: bool) -> tuple[str, ...]:
    """Names of a map's channels in its file, for F0 of `specular` channels."""
    letters = (_JOINED if single else _OWN)["diffuse" if (kind, specular) == _COLOUR else kind]
    return tuple(f"{kind}.{letter}" for letter in letters) if single else tuple(letters)


def encode(
    planes: NDArray[np.float32], part: BlockPart, pictures: Sequence[PictureFile], specular: int
) -> list[Rendered]:
    """Encode the whole tiles of a part of a block for each picture.

    Args:
        specular: channels of F0.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
    """
    check_heights(planes[kind_planes(specular)["height"][0]], "the material")
    return [_encode(picture, part, planes) for picture in pictures]


def _encode(picture: PictureFile, part: BlockPart, planes: NDArray[np.float32]) -> Rendered:
    layout = picture.layout
    values = [
        stored(channel, planes[plane], picture.file)
        for channel, plane in zip(layout.channels, picture.planes, strict=True)
    ]
    tiles, fragments = [], []
    for tile in tiles_over(part.target):
        area = layout.area(tile)
        inner = intersection(area, part.target)
        cut = [plane[relative(inner, part.target)] for plane in values]
        if inner == area:
            tiles.append((tile, encode_tile(layout, tile, cut)))
        else:
            fragments.append(Fragment(tile, relative(inner, area), cut))
    return Rendered(tiles, fragments)
