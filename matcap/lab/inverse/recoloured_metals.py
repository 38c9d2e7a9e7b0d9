"""Augmentation of metals: half of them get another colour, for map sets have few."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.lab.simulate.materials.kinds.coloured_metals import anodised_f0, metal_colour

_AS_IT_IS, _KNOWN = 0.4, 0.35  # of pieces; the rest are dyed
_DARKEST, _MOST = 0.015, 0.98
_SOME, _SOME_SHARE = 0.5, 0.01  # a piece with this share of texels more metal than that is coloured

Picture = NDArray[np.float32]


def coloured_metal(specular: Picture, metal: Picture, rng: np.random.Generator) -> Picture:
    """F0 (3, H, W) with its metal recoloured at random, or unchanged.

    Contrast and variations of colour are preserved.

    Args:
        specular: (3, H, W) F0.
        metal: (1, H, W) share that is metal.
        rng: random numbers.
    """
    which = rng.random()
    if which < _AS_IT_IS or float((metal > _SOME).mean()) < _SOME_SHARE:
        return specular
    colour = metal_colour(rng) if which < _AS_IT_IS + _KNOWN else anodised_f0(rng)
    mean = float((specular * metal).sum() / (3.0 * metal.sum()))
    gain = 1.0 + metal * (colour.astype(np.float32)[:, None, None] / np.float32(mean) - 1.0)
    return np.asarray((specular * gain).clip(_DARKEST, _MOST), np.float32)
