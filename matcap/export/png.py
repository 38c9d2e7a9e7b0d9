"""PNG files of 8 and 16 bits, rounded (a truncating writer darkens by half a step)."""

from __future__ import annotations

from pathlib import Path

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
    import cv2

    if not np.isfinite(coded).all():
        raise MatcapError("has values that are not finite", where=path.name)
    whole = np.rint(np.clip(coded, 0.0, 1.0) * (2.0**bits - 1.0))
    stored = whole.astype(np.uint8 if bits == 8 else np.uint16)
    stored = stored[..., ::-1] if stored.ndim == 3 else stored
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(stored))
    path.write_bytes(encoded.tobytes())
