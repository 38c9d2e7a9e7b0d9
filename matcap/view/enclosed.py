"""Maps inside a document for sending, which page/tile.js unpacks.

The document's element `about` is JSON; its entry `tile` holds the maps, and its entry `enclosed`
the photographed piece, where it is known. What is called `data` is base64 of zlib of bytes.

Tile:
    size: (width, height) in texels.
    specular_channels: 1, or 3 where F0 has a colour.
    low: the lowest height, plane units.
    span: the highest height less the lowest.
    data: 16-bit words, all low bytes before all high ones: the planes of diffuse (3), specular and
        roughness as half floats, then height: low + word / 65535 * span. Albedos have 8 bits after
        the leading one: an eighth of a code value, and noise that would not compress.

Piece:
    size: (width, height) in texels of the level.
    level: a texel of it is 2^level texels of the material wide.
    diffuse: a JPEG, as an address that holds its data.
    specular_channels: 1, or 3 where F0 has a colour.
    low: the lowest specular (of each channel), roughness (with what slopes vary within a texel) and
        height.
    span: the highest of each less the lowest.
    data: specular, then roughness, in 255 steps a byte, then low and high bytes of height in 65535
        steps; every number less the one before it.
"""

from __future__ import annotations

import base64
import io
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.exr import LARGEST_HALF
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

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.example.exemplar import Exemplar

_QUALITY = 90  # of its diffuse albedo's JPEG
_SPARED = 2  # bits of a half float's ten that albedos do without


def packed_tile(maps: MapSet) -> dict[str, Any]:
    """A tile as the page's JSON has it.

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
    # Bytes of one kind together compress better.
    split = words.view(np.uint8).reshape(-1, 2).T
    return {
        "size": list(maps.size),
        "specular_channels": len(maps.specular),
        "low": low,
        "span": span,
        "data": _text(split),
    }


def packed_piece(exemplar: Exemplar, side: int) -> dict[str, Any]:
    """An exemplar as the page's JSON has it, at most `side` texels along its longer side."""
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
    return {
        "size": [moments.shape[2], moments.shape[1]],
        "level": level,
        "specular_channels": len(moments[F0]),
        "diffuse": _jpeg(moments[DIFFUSE]),
        "low": [low for low, _ in ends],
        "span": [span for _, span in ends],
        "data": _text(np.concatenate(parts)),
    }


def _roughness(moments: Planes, texel_size: float) -> NDArray[np.float32]:
    """(H, W) perceptual: with what the slopes of the heights alone would not vary."""
    stacked = np.zeros((6, *moments.shape[1:]), np.float32)
    stacked[5] = moments[HEIGHT]
    left = np.maximum(moments[SQUARES] - moments_of(edged(stacked), texel_size)[SQUARES], 0.0)
    rough: NDArray[np.float32] = np.sqrt(np.sqrt(np.minimum(moments[ALPHA2] + left, 1.0)))
    return rough


def _shortened(halves: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Bits of half floats, rounded to fewer."""
    half = np.uint16(1 << _SPARED >> 1)
    short: NDArray[np.uint16] = (halves + half) & np.uint16(0xFFFF << _SPARED & 0xFFFF)
    return short


def _ends(plane: NDArray[np.float32]) -> tuple[float, float]:
    low, high = float(plane.min()), float(plane.max())
    return low, high - low or 1.0


def _jpeg(albedo: Planes) -> str:
    from PIL import Image

    from matcap.files.srgb import srgb_picture

    stored = io.BytesIO()
    codes = np.rint(srgb_picture(albedo.transpose(1, 2, 0)) * 255.0).astype(np.uint8)
    Image.fromarray(codes).save(stored, "JPEG", quality=_QUALITY, subsampling=0)
    return f"data:image/jpeg;base64,{base64.b64encode(stored.getvalue()).decode()}"


def _text(data: NDArray[np.uint8]) -> str:
    return base64.b64encode(zlib.compress(data.tobytes(), 9)).decode()
