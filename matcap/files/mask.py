"""Masks: which part of a picture is meant, as grey or as transparency."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError


def read_mask(path: Path) -> NDArray[np.float32]:
    """(H, W) in [0, 1] of a picture of 8 or 16 bits: white and opaque is 1.

    What is painted on a transparent layer is seen over black. A layer of one colour is its alpha,
    whatever the colour: painted in black on nothing, too, it means what is painted.

    Raises:
        MatcapError: not a picture that OpenCV reads.
    """
    coded = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if coded is None or coded.dtype not in (np.uint8, np.uint16):
        raise MatcapError(
            "this is no picture of 8 or 16 bits", where=str(path), remedy="save it as a PNG"
        )
    shown: NDArray[np.float32] = coded.astype(np.float32) / np.float32(
        255.0 if coded.dtype == np.uint8 else 65535.0
    )
    if shown.ndim == 2:
        return shown
    alpha = shown[..., -1] if shown.shape[2] in (2, 4) else np.ones(shown.shape[:2], np.float32)
    colors = shown[..., :3] if shown.shape[2] >= 3 else shown[..., :1]
    grey = cv2.cvtColor(colors, cv2.COLOR_BGR2GRAY) if colors.shape[2] == 3 else colors[..., 0]
    painted = grey[alpha > 0.0]
    if float(alpha.min()) < 1.0 and painted.size and float(np.ptp(painted)) < 1e-3:
        return np.asarray(alpha, np.float32)
    return np.asarray(grey * alpha, np.float32)
