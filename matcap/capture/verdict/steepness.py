"""Steepness: relief of a decoder's field over that of the exemplar which it was fine-tuned by.

Under a flash near the lens a dent and a stain look alike, so that statistics of the photograph let
a decoder draw stains as relief. Slopes of waves of 8 to 64 texels are compared: finer ones would
hide slow relief, and decoders blur the finest.
"""

from __future__ import annotations

import math

import numpy as np

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.relief_spectrum import slope_spectrum

_COARSE = slice(0, 3)  # of filters.BANDS: 8 to 64 texels
_FLAT = 0.01  # root-mean-square slope of these waves below which a surface is flat to the eye


def steepness(drawn: MapSet, exemplar: MapSet) -> float:
    """Root-mean-square slope of maps over that of an exemplar.

    NaN if both are flat or too small.
    """
    energies = [
        float(np.square(slope_spectrum((maps.height[0] / maps.texel_size).numpy())[_COARSE]).sum())
        for maps in (drawn, exemplar)
    ]
    ours, theirs = (energy + _FLAT**2 for energy in energies)
    return math.sqrt(ours / theirs) if any(energies) else math.nan
