"""Reading what was exported, without matcap's own code."""

import cv2
import numpy as np
import torch

# Rough, polished, and of two kinds.
MATERIALS = ("leather", "granite", "rust")
METALS = ("gold", "rust beside steel", "worn paint", "blue anodised")


def picture(path) -> np.ndarray:
    """(H, W[, C]) code values in [0, 1], channels in RGB order."""
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    order = {2: ..., 3: (..., [2, 1, 0]), 4: (..., [2, 1, 0, 3])}
    colour = stored if stored.ndim == 2 else stored[order[stored.shape[2]]]
    return colour / np.float64(np.iinfo(stored.dtype).max)


def linear(code: np.ndarray) -> np.ndarray:
    """sRGB decoded, written a second time here."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def channels(array: np.ndarray) -> torch.Tensor:
    """(C, H, W) float64."""
    tensor = torch.from_numpy(np.ascontiguousarray(array))
    return tensor[None] if tensor.ndim == 2 else tensor.movedim(-1, 0)


def averaged(image: np.ndarray, block: int = 16) -> np.ndarray:
    """Means of blocks of pixels: of the material, and not of how pictures are filtered."""
    height, width = (side // block * block for side in image.shape[:2])
    parts = image[:height, :width].reshape(height // block, block, width // block, block, 3)
    return parts.mean(axis=(1, 3))


def unlike(found: np.ndarray, true: np.ndarray) -> float:
    """Share of light that differs between two pictures, averaged over 16 x 16 pixels."""
    found, true = averaged(found), averaged(true)
    return float(np.abs(found - true).sum() / true.sum())
