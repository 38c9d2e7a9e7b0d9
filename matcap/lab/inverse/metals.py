"""Metals' colours as training draws them: published ones, alloys between, and anodised ones.

F0 by channel, linear Rec.709, of polished metals: Hoffman 2010, "Physics and math of shading"
(SIGGRAPH course), table of Fresnel reflectance at normal incidence.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

PUBLISHED = {
    "silver": (0.972, 0.960, 0.915),
    "aluminium": (0.913, 0.922, 0.924),
    "iron": (0.562, 0.565, 0.578),
    "titanium": (0.542, 0.497, 0.449),
    "gold": (1.0, 0.766, 0.336),
    "copper": (0.955, 0.638, 0.538),
    "brass": (0.887, 0.789, 0.434),
    "bronze": (0.714, 0.428, 0.181),
}
_AS_IT_IS, _PUBLISHED_SHARE = 0.4, 0.35  # of pieces; the rest are anodised
_ALLOYED = 0.06  # deviation of log F0 of each channel
_MOST = 0.98
_SOME, _SOME_SHARE = 0.5, 0.01  # a piece with this share of texels more metal than that is coloured

Picture = NDArray[np.float32]


def coloured_metal(surface: Picture, metal: Picture, rng: np.random.Generator) -> Picture:
    """F0 (3, H, W) of a piece, its metal of a colour drawn anew, or as it is.

    Args:
        surface: (3, H, W) F0.
        metal: (1, H, W) share that is metal.
        rng: draws.
    """
    which = rng.random()
    if which < _AS_IT_IS or float((metal > _SOME).mean()) < _SOME_SHARE:
        return surface
    if which < _AS_IT_IS + _PUBLISHED_SHARE:
        names = list(PUBLISHED)
        colour = np.array(PUBLISHED[names[int(rng.integers(len(names)))]])
        colour = colour * np.exp(rng.normal(0.0, _ALLOYED, 3))
        level = colour.mean()
    else:  # a dyed film on aluminium
        hue = rng.uniform(0.0, 2.0 * math.pi)
        wave = np.cos(hue + np.array([0.0, -2.0, 2.0]) * math.pi / 3.0)
        colour = np.exp(rng.uniform(0.2, 1.6) * wave)
        level = math.exp(rng.uniform(math.log(0.12), math.log(0.6)))
    colour = (colour / colour.mean()).astype(np.float32)[:, None, None]
    mean = float((surface * metal).sum() / (3.0 * metal.sum()))
    # Its own contrast and the colours in it stay, but for its hue as a whole.
    gain = 1.0 + metal * (colour * np.float32(level / mean) - 1.0)
    return np.asarray((surface * gain).clip(0.015, _MOST), np.float32)
