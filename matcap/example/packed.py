"""Compressed integer arrays: differences along rows, low bytes before high bytes, deflate.

Of deflate only runs and Huffman codes are used: differences repeat rarely, and the search for
longer matches takes eight times as long for files that are not smaller.

Decoding checks sizes, as files may be damaged or hostile.
"""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def pack(codes: NDArray[Any]) -> NDArray[np.uint8]:
    """Compress an integer array."""
    swapped = codes.copy()
    swapped[..., 1:] -= codes[..., :-1]
    planes = swapped.astype(swapped.dtype.newbyteorder("<")).view(np.uint8)
    planes = planes.reshape(-1, swapped.dtype.itemsize).T
    deflate = zlib.compressobj(strategy=zlib.Z_RLE)
    return np.frombuffer(deflate.compress(planes.tobytes()) + deflate.flush(), np.uint8)


def unpack(packed: NDArray[np.uint8], shape: tuple[int, ...], kind: type) -> NDArray[Any]:
    """Decompress an array of a shape and type; never allocates more than that needs.

    Raises:
        ValueError: the data are not of this shape and type.
    """
    wanted = np.dtype(kind).newbyteorder("<")
    size = math.prod(shape) * wanted.itemsize
    opened = zlib.decompressobj()
    try:
        data = opened.decompress(packed.tobytes(), size + 1)
    except zlib.error as error:
        raise ValueError(f"bytes that cannot be unpacked ({error})") from error
    if len(data) != size or not opened.eof:
        raise ValueError(f"{len(data)} bytes, expected {size}")
    planes = np.frombuffer(data, np.uint8).reshape(wanted.itemsize, -1).T
    values = np.ascontiguousarray(planes).view(wanted).reshape(shape)
    return np.cumsum(values, axis=-1, dtype=kind)
