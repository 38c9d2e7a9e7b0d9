"""Difference of the colour distributions of two pictures: L1 distance of CIE XYZ histograms.

The paper's second metric of likeness (section 5.2, "XYZ histogram L1 difference"), which does not
say how many bins it has; here it is 64 a channel, from black to the white of sRGB.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from matcap.files.srgb import srgb_decode
from matcap.lab.simulate.write_dng import REC709_TO_XYZ

BINS = 64


def xyz_histograms(picture: Tensor) -> NDArray[np.float64]:
    """(3, BINS) normalised histograms of X, Y and Z of an sRGB picture (3, H, W) in [0, 1]."""
    light = srgb_decode(picture.double().flatten(1).numpy())
    white = REC709_TO_XYZ.sum(axis=1, keepdims=True)
    shares = (REC709_TO_XYZ @ light / white).clip(0.0, 1.0)
    counts = [np.histogram(channel, BINS, (0.0, 1.0))[0] for channel in shares]
    return np.stack(counts) / light.shape[1]


def xyz_difference(first: Tensor, second: Tensor) -> float:
    """Half the L1 difference of histograms of sRGB pictures (3, H, W), the mean of X, Y and Z.

    0 for equal histograms, 1 for disjoint ones. The pictures may differ in size.
    """
    difference = np.abs(xyz_histograms(first) - xyz_histograms(second)).sum(axis=1)
    return float(difference.mean() / 2.0)
