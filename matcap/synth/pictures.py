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
    name: str, size: tuple[int, int], *, specular: int, mipmap: bool, wrap: str
) -> tuple[PictureFile, ...]:
    """The files of a map set.

    Args:
        name: prefix of the file names; `{kind}` is replaced by the map's name.
        size: (width, height) in texels.
        specular: channels of F0.
        mipmap, wrap: see Layout.
    """
    pictures = []
    for kind, planes in kind_planes(specular).items():
        named = sorted(zip("RGB" if len(planes) == 3 else "Y", planes, strict=True))
        channels = tuple(Channel(letter, kind != "height") for letter, _ in named)
        pictures.append(
            PictureFile(
                f"{name.replace('{kind}', kind)}.exr",
                Layout(*size, channels, mipmap, wrap),
                tuple(plane for _, plane in named),
                (kind,) * len(named),
            )
        )
    return tuple(pictures)


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
