"""PNG files of 8 and 16 bits, rounded (a truncating writer darkens by half a step)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError


def write_png(path: Path, coded: NDArray[np.float32], *, bits: int) -> None:
    """Write code values in [0, 1], clipped there: (H, W, 3) colour or (H, W) grey.

    Encoded in memory first, so that a full disk is an OSError and never a short file. Not atomic:
    write into a staged folder.

    Raises:
        MatcapError: a value is not finite.
        OSError: the file cannot be written.
    """
    if not np.isfinite(coded).all():
        raise MatcapError("has values that are not finite", where=path.name)
    path.write_bytes(png_bytes(quantised(coded, bits=bits)))


def quantised(coded: NDArray[np.float32], *, bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Whole code values, rounded, of finite ones in [0, 1], clipped there; any shape."""
    whole = np.rint(np.clip(coded, 0.0, 1.0) * (2.0**bits - 1.0))
    return whole.astype(np.uint8) if bits == 8 else whole.astype(np.uint16)


def png_bytes(whole: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """A PNG file of (H, W, 4), (H, W, 3) or (H, W) whole code values."""
    import cv2

    _, encoded = cv2.imencode(".png", turned(whole))
    return encoded.tobytes()


def turned(whole: NDArray[Any]) -> NDArray[Any]:
    """(H, W, 4), (H, W, 3) or (H, W) with red and blue exchanged, as OpenCV stores colours."""
    import cv2

    whole = np.ascontiguousarray(whole)
    if whole.ndim == 2:
        return whole
    way = cv2.COLOR_RGB2BGR if whole.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    return np.asarray(cv2.cvtColor(whole, way))
