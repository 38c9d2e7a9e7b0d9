"""Local contrast normalisation of albedo: a stationary sample has the same contrast everywhere.

Where a highlight lies over it, albedo hardly shows, and the network's answer fades. What is left of
every band is given the contrast that the band has where albedo is seen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.capture.piece.smooth import smoothed, split
from matcap.capture.piece.tuned import ADAPT

Floats = NDArray[np.float32]


def even_contrast(albedo: Floats, weight: Floats) -> Floats:
    """Log albedo (3, H, W) whose bands vary as much everywhere as where they are seen.

    Args:
        albedo: as the network gives it.
        weight: (H, W) how far it is seen, in [0, 1].
    """
    local = weight + np.float32(ADAPT.contrast_unseen)
    under = smoothed(local, ADAPT.contrast_around)
    grey = split(albedo.mean(0))
    channels = [split(channel) for channel in albedo]
    even = np.stack([bands[-1] for bands in channels])
    for index, band in enumerate(grey[:-1]):
        squared = np.square(band)
        wanted = np.sqrt((squared * weight).sum() / max(float(weight.sum()), 1e-9))
        here = np.sqrt(smoothed(squared * local, ADAPT.contrast_around) / under)
        gain = wanted / np.maximum(here, ADAPT.contrast_faintest)
        gain = gain.clip(ADAPT.contrast_least, ADAPT.contrast_most)
        even += gain * np.stack([bands[index] for bands in channels])
    return even
