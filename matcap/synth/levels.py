"""Mip levels of a file: box averages of the next larger level.

Normals are averaged and normalised. Roughness is averaged; the variance of the normals that is lost
is not added to it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from matcap.synth.exr_tiles import (
    Area,
    Tile,
    TileFile,
    encode_tile,
    intersection,
    relative,
    stored,
    tiles_over,
)
from matcap.synth.pictures import PictureFile

_TOGETHER = 64  # tiles computed before they are appended


def write_levels(picture: PictureFile, file: TileFile, workers: int) -> None:
    """Append the missing tiles of all levels but the first, which must be complete."""
    with ThreadPoolExecutor(workers) as pool:
        for level in range(1, file.layout.levels):
            file.flush()
            width, height = file.layout.size(level)
            tiles = tiles_over((slice(0, height), slice(0, width)), level)
            missing = (tile for tile in tiles if tile not in file)
            while some := list(itertools.islice(missing, _TOGETHER)):
                chunks = pool.map(lambda tile: _average(picture, file, tile), some)
                for tile, chunk in zip(some, chunks, strict=True):
                    file.append(tile, chunk)


def _average(picture: PictureFile, file: TileFile, tile: Tile) -> bytes:
    layout, above = file.layout, tile.level - 1
    (wide, high), (width, height) = layout.size(above), layout.size(tile.level)
    rows, columns = layout.area(tile)
    across, from_column = _weights(columns, width, wide)
    down, from_row = _weights(rows, height, high)
    planes = read_planes(file, above, (from_row, from_column))
    shrunk = [down @ plane.astype(np.float32) @ across.T for plane in planes]
    normals = [shrunk[place] for place in picture.places("normal")]
    if normals:
        length = np.sqrt(sum(np.square(one) for one in normals))
        for one in normals:
            one /= np.maximum(length, 1e-6)
    channels = zip(layout.channels, shrunk, strict=True)
    return encode_tile(layout, tile, [stored(c, plane, picture.file) for c, plane in channels])


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


def read_planes(file: TileFile, level: int, area: Area) -> Sequence[NDArray[np.generic]]:
    """Read the planes of an area (rows, columns) of a level whose tiles are complete."""
    rows, columns = area
    shape = (rows.stop - rows.start, columns.stop - columns.start)
    planes = [np.empty(shape, channel.dtype) for channel in file.layout.channels]
    for tile in tiles_over(area, level):
        whole = file.layout.area(tile)
        inner = intersection(whole, area)
        for plane, part in zip(planes, file.read(tile), strict=True):
            plane[relative(inner, area)] = part[relative(inner, whole)]
    return planes
