"""The metallic workflow of games: base colour, metallic and a small range of F0 for the rest.

diffuse = base (1 - metallic), F0 = dielectric (1 - metallic) + base metallic. Only what is a metal
becomes one: no dielectric that lies about has an F0 of 0.2, and a leather that is a little metal
takes on a metal's tinted reflection and looks wrong under every light. Dielectrics with an F0 that
the target cannot say get the nearest it can; what is lost is for surface.residual to tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from matcap.export.formats import Picture

_HALVINGS = 12  # of metallic: finer than 8 bits
# F0 from which a material is a metal in part, and altogether. Diamond, the highest of dielectrics
# that anybody photographs, has 0.17; titanium, the lowest of bare metals, 0.5.
FIRST_METAL, SURE_METAL = 0.2, 0.3


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


def to_metallic(
    diffuse: Picture, specular: Picture, *, lowest: float, highest: float, below: float = 1.0
) -> Metallic:
    """The nearest metallic material: the right diffuse, and the right mean F0 where it exists.

    Args:
        diffuse: (H, W, 3) diffuse albedo.
        specular: (H, W) F0.
        lowest: smallest F0 of a dielectric that the target knows.
        highest: largest; the same as `lowest` where F0 is fixed.
        below: the share of a dielectric's base colour that is its diffuse albedo.
    """
    dielectric = np.clip(specular, lowest, highest).astype(np.float32)
    allowed = np.clip((specular - FIRST_METAL) / (SURE_METAL - FIRST_METAL), 0.0, 1.0)
    low, high = np.zeros_like(specular), np.ones_like(specular)
    if (allowed > 0.0).any():
        for _ in range(_HALVINGS):
            middle = (low + high) / 2.0
            base = _base(diffuse, specular, middle, below).mean(axis=-1)
            f0 = highest * (1.0 - middle) + middle * base
            low, high = np.where(f0 < specular, middle, low), np.where(f0 < specular, high, middle)
    metallic = np.where(specular > highest, high * allowed, 0.0).astype(np.float32)
    return Metallic(_base(diffuse, specular, metallic, below), metallic, dielectric)


def _base(diffuse: Picture, specular: Picture, metallic: Picture, below: float) -> Picture:
    """Base colour that gives the diffuse albedo; where there is none, one that gives F0."""
    rest = (below * (1.0 - metallic))[..., None]
    black = diffuse.max(axis=-1, keepdims=True) < 1e-4
    base = np.where(black, specular[..., None], diffuse / np.maximum(rest, 1e-6))
    return np.clip(base, 0.0, 1.0).astype(np.float32)
