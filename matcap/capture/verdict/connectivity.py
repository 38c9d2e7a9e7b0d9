"""Connectivity: whether the dark or the bright lines of a pattern form connected nets.

Leather is bright cells in a dark net; broken into spots, the net has the same contrast, spectrum
and neighbouring texels. In windows of a band of log luminance, a phase is the SHARE of texels that
are the darkest or the brightest, n_i the sizes of its clusters (4-connected), and

    S = sum n_i^2 / sum n_i,    connectivity = log(S_dark / S_bright),

S the mean cluster size of percolation theory [stauffer1994, sec. 2.3]. It is positive for a dark
net, negative for a bright one, 0 where both phases look alike.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.photo.inspect import band_passed
from matcap.photo.shrink import area_averaged

Picture = NDArray[np.float32]
TexelMask = NDArray[np.bool_]

SHARE = 0.4  # just below where the phases of a Gaussian field span it, so that S varies most
_WIDTH = 1024  # texels across at which patterns are compared
_BANDS = ((2.0, 8.0), (4.0, 16.0))  # standard deviations of two Gaussian blurs, texels
_WINDOW, _STEP = 192, 160  # texels
_LEAST_SEEN = 0.9  # valid share of a window


def connectivity(pictures: tuple[Picture, Picture], valid: TexelMask) -> tuple[float, float] | None:
    """Connectivity of log luminance (H, W) of a photograph and its re-rendering.

    Medians over windows, in the band that differs most; None if the picture is too small.
    """
    rows, columns = valid.shape
    shrink = max(1.0, columns / _WIDTH)
    size = (round(columns / shrink), round(rows / shrink))
    before, after, seen = (
        area_averaged(one, size) for one in (*pictures, valid.astype(np.float32))
    )
    places = [
        (slice(y, y + _WINDOW), slice(x, x + _WINDOW))
        for y in range(0, size[1] - _WINDOW + 1, _STEP)
        for x in range(0, size[0] - _WINDOW + 1, _STEP)
    ]
    places = [place for place in places if seen[place].mean() > _LEAST_SEEN]
    if not places:
        return None
    medians = []
    for deviations in _BANDS:
        bands = [band_passed(one, *deviations) for one in (before, after)]
        each = np.array([[_of_window(band[place]) for band in bands] for place in places])
        middle = float(np.median(each[:, 0]))
        # Both of a pair have the same light, so their difference has the smaller scatter.
        medians.append((middle, middle + float(np.median(each[:, 1] - each[:, 0]))))
    return max(medians, key=lambda pair: abs(pair[1] - pair[0]))


def _of_window(band: Picture) -> float:
    """log(S_dark / S_bright) of a window."""
    dark, bright = (_mean_cluster_size(side <= np.quantile(side, SHARE)) for side in (band, -band))
    return float(np.log(dark / bright))


def _mean_cluster_size(phase: TexelMask) -> float:
    _, _, stats, _ = cv2.connectedComponentsWithStats(phase.astype(np.uint8), connectivity=4)
    sizes = stats[1:, cv2.CC_STAT_AREA].astype(np.float64)
    return float(np.square(sizes).sum() / sizes.sum())
