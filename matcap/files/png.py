"""Writes PNG files of 8 and 16 bits; values are rounded, not truncated."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError

PNG_HEADER = 33  # bytes: signature and IHDR


def write_png(path: Path, coded: NDArray[np.float32], *, bits: int) -> None:
    """Write code values (H, W, 3) or (H, W), clipped to [0, 1].

    Encoded in memory first, so that a full disk raises OSError. Not atomic: write into a staged
    folder.

    Raises:
        MatcapError: a value is not finite.
        OSError: the file cannot be written.
    """
    if not np.isfinite(coded).all():
        raise MatcapError("has values that are not finite", where=path.name)
    path.write_bytes(png_bytes(quantised(coded, bits=bits)))


def quantised(coded: NDArray[np.float32], *, bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Integer code values of finite values, clipped to [0, 1] and rounded; any shape."""
    whole = np.rint(np.clip(coded, 0.0, 1.0) * (2.0**bits - 1.0))
    return whole.astype(np.uint8) if bits == 8 else whole.astype(np.uint16)


def png_bytes(whole: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Encode (H, W, 4), (H, W, 3) or (H, W) code values as PNG."""
    import cv2

    _, encoded = cv2.imencode(".png", swap_red_blue(whole))
    return encoded.tobytes()


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """A chunk of a PNG file: length, type, data and checksum (PNG 3rd edition, 5.3)."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def swap_red_blue(whole: NDArray[Any]) -> NDArray[Any]:
    """(H, W, 4), (H, W, 3) or (H, W) with red and blue exchanged, for OpenCV."""
    import cv2

    whole = np.ascontiguousarray(whole)
    if whole.ndim == 2:
        return whole
    conversion = cv2.COLOR_RGB2BGR if whole.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    return np.asarray(cv2.cvtColor(whole, conversion))
