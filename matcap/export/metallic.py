"""The metallic workflow of games: base colour, metallic and a small range of F0 for the rest.

diffuse = base (1 - metallic), F0 = dielectric (1 - metallic) + base metallic. A grey F0 above the
dielectric one can only be had by becoming partly metal, which lends its colour to the reflection,
and by a brighter base, which ends at 1. What is lost is for surface.residual to tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float32]
_HALVINGS = 24  # of metallic: to float32's own steps


@dataclass(frozen=True)
class Metallic:
    """A material in the metallic workflow.

    Attributes:
        base: (H, W, 3) base colour in [0, 1].
        metallic: (H, W) in [0, 1].
        dielectric: (H, W) F0 of the part that is no metal.
    """

    base: Picture
    metallic: Picture
    dielectric: Picture


def to_metallic(diffuse: Picture, specular: Picture, *, lowest: float, highest: float) -> Metallic:
    """The nearest metallic material: the right diffuse, and the right mean F0 where it exists.

    Args:
        diffuse: (H, W, 3) diffuse albedo.
        specular: (H, W) F0.
        lowest: smallest F0 of a dielectric that the target knows.
        highest: largest; the same as `lowest` where F0 is fixed.
    """
    dielectric = np.clip(specular, lowest, highest).astype(np.float32)
    low, high = np.zeros_like(specular), np.ones_like(specular)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        f0 = highest * (1.0 - middle) + middle * _base(diffuse, specular, middle).mean(axis=-1)
        low, high = np.where(f0 < specular, middle, low), np.where(f0 < specular, high, middle)
    metallic = np.where(specular > highest, high, 0.0).astype(np.float32)
    return Metallic(_base(diffuse, specular, metallic), metallic, dielectric)


def _base(diffuse: Picture, specular: Picture, metallic: Picture) -> Picture:
    """Base colour that gives the diffuse albedo; where there is none, one that gives F0."""
    rest = (1.0 - metallic)[..., None]
    black = diffuse.max(axis=-1, keepdims=True) < 1e-4
    base = np.where(black, specular[..., None], diffuse / np.maximum(rest, 1e-6))
    return np.clip(base, 0.0, 1.0).astype(np.float32)
