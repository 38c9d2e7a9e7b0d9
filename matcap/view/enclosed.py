"""Maps inside a self-contained document, which page/tile.js unpacks.

The document's element `about` is JSON; its entry `tile` is a tile's maps, and its entry `enclosed`
the exemplar, or null. Entries called `data` are base64 of zlib-compressed bytes.

Tile:
    size: (width, height) in texels.
    specular_channels: 1, or 3 where F0 has a colour.
    low: least height, plane units.
    span: greatest height less the least.
    data: 16-bit words, all low bytes before all high bytes: planes of diffuse (3), specular and
        roughness as half floats, then height: low + word / 65535 * span. Diffuse and specular are
        rounded to 8 of the 10 fraction bits, so that they compress better.

Exemplar:
    size: (width, height) in texels of the level.
    level: texels are 2^level texels of the material wide.
    diffuse: a JPEG as a data URL.
    specular_channels: 1, or 3 where F0 has a colour.
    low: least value of each specular channel, of roughness and of height. Roughness includes the
        variance of normals within a texel.
    span: greatest value of each less the least.
    data: specular, then roughness, in 255 steps a byte, then low and high bytes of height in 65535
        steps; each number is the difference from the one before.
"""

from __future__ import annotations

import base64
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.exr import LARGEST_HALF
from matcap.files.picture import jpeg_bytes
from matcap.view.moments import (
    ALPHA2,
    DIFFUSE,
    F0,
    HEIGHT,
    SQUARES,
    Planes,
    edged,
    halved,
    moments_of,
)  # fmt: skip
from matcap.view.references import EncodedPicture

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.example.exemplar import Exemplar

_QUALITY = 90  # of the exemplar's JPEG
_SPARED = 2  # fraction bits of half floats that albedos are rounded by


def packed_tile(maps: MapSet) -> dict[str, Any]:
    """The JSON entry of a tile.

    Raises:
        MatcapError: maps of values that half floats cannot hold.
    """
    stacked = maps.stacked().numpy()
    surface, height = stacked[:-1], stacked[-1]
    if np.abs(surface).max() > LARGEST_HALF:
        raise MatcapError(
            "the maps have values too large for half float (65504)", remedy="scale them down"
        )
    low, span = _ends(height)
    steps = np.rint((height - low) / span * 65535.0).astype("<u2")
    halves = surface.astype("<f2").view("<u2")
    halves[:-1] = _shortened(halves[:-1])
    words = np.concatenate([halves.ravel(), steps.ravel()])
    # All low bytes before all high bytes, which compresses better.
    split = words.view(np.uint8).reshape(-1, 2).T
    return {
        "size": list(maps.size),
        "specular_channels": len(maps.specular),
        "low": low,
        "span": span,
        "data": _text(split),
    }


def packed_piece(exemplar: Exemplar, side: int) -> dict[str, Any]:
    """The JSON entry of an exemplar, of at most `side` texels along its longer side."""
    level, moments = 0, moments_of(edged(exemplar.stacked()), exemplar.texel_size)
    while max(moments.shape[1:]) > side:
        height, width = moments.shape[1:]
        moments = halved(moments[:, : height & ~1, : width & ~1])
        level += 1
    rough = _roughness(moments, exemplar.texel_size * 2**level)
    parts, ends = [], []
    planes = [*((plane, 255) for plane in (*moments[F0], rough)), (moments[HEIGHT], 65535)]
    for plane, steps in planes:
        low, span = _ends(plane)
        ends.append((low, span))
        words = np.rint((plane - low) / span * steps).astype("<u1" if steps == 255 else "<u2")
        words = np.diff(words.ravel(), prepend=words.dtype.type(0))
        parts.append(words.view(np.uint8).reshape(words.size, -1).T.ravel())
    diffuse = jpeg_bytes(moments[DIFFUSE].transpose(1, 2, 0), _QUALITY, subsampling=0)
    return {
        "size": [moments.shape[2], moments.shape[1]],
        "level": level,
        "specular_channels": len(moments[F0]),
        "diffuse": EncodedPicture(diffuse, "image/jpeg").url,
        "low": [low for low, _ in ends],
        "span": [span for _, span in ends],
        "data": _text(np.concatenate(parts)),
    }


def _roughness(moments: Planes, texel_size: float) -> NDArray[np.float32]:
    """(H, W) perceptual roughness, including slope variance that the heights do not show."""
    stacked = np.zeros((6, *moments.shape[1:]), np.float32)
    stacked[5] = moments[HEIGHT]
    left = np.maximum(moments[SQUARES] - moments_of(edged(stacked), texel_size)[SQUARES], 0.0)
    return np.sqrt(np.sqrt(np.minimum(moments[ALPHA2] + left, 1.0)))


def _shortened(halves: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Half floats, as their bits, rounded to _SPARED bits fewer."""
    half = np.uint16(1 << _SPARED >> 1)
    return (halves + half) & np.uint16(0xFFFF << _SPARED & 0xFFFF)


def _ends(plane: NDArray[np.float32]) -> tuple[float, float]:
    low, high = float(plane.min()), float(plane.max())
    return low, high - low or 1.0


def _text(data: NDArray[np.uint8]) -> str:
    return base64.b64encode(zlib.compress(data.tobytes(), 9)).decode()
