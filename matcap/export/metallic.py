"""Conversion to the metallic workflow: base colour, metallic, and F0 of dielectrics.

diffuse = base (1 - metallic), F0 = dielectric (1 - metallic) + base metallic. This cannot represent
every diffuse albedo and F0. Of three forms, the one with the smallest residual is written
(presets.py):

- plain: metallic is above 0 only where F0 is above 0.2, which no common dielectric reaches. The
  base colour reproduces the diffuse albedo, metallic the mean F0.
- tinted: the same metallic; the base colour is the least-squares compromise of diffuse and F0.
- free: base colour, metallic and dielectric F0 minimise the difference of light; exact for maps of
  a metallic material. Dielectrics may become metallic, so it must be clearly better.

surface.residuals measures the remaining error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from matcap.export.fit import ErrorWeights
from matcap.export.formats import Picture, mean_channel, rgb

Form = Literal["plain", "tinted", "free"]
FORMS: tuple[Form, ...] = get_args(Form)

_HALVINGS = 12  # bisections of metallic: finer than 8 bits
# F0 where metallic starts, and where it may be 1. Diamond, the highest common dielectric, has 0.17;
# titanium, the lowest bare metal, 0.5.
FIRST_METAL, SURE_METAL = 0.2, 0.3
_FIRST_STEPS, _FINER = 8, 6  # free form: steps over [0, 1], then halvings around the best
_BETTER = 1e-9  # least gain, in squared light, for another metallic


@dataclass(frozen=True)
class Metallic:
    """A material in the metallic workflow."""

    base: Picture
    """(H, W, 3) base colour in [0, 1]."""
    metallic: Picture
    """(H, W) in [0, 1]."""
    dielectric: Picture
    """(H, W) F0 of the dielectric part."""


@dataclass(frozen=True)
class MetallicAim:
    """The reflectance to reproduce, and the target's limits."""

    diffuse: Picture
    """(H, W, 3) diffuse albedo."""
    specular: Picture
    """(H, W) or (H, W, 3) F0."""
    roughness: Picture
    """(H, W) perceptual roughness."""
    lowest: float
    """Smallest F0 of a dielectric in the target."""
    highest: float
    """Largest; equal to `lowest` where F0 is fixed."""
    below: float = 1.0
    """Diffuse albedo over base colour, of a dielectric."""


def to_metallic(wanted: MetallicAim, form: Form = "plain") -> Metallic:
    """Convert to the metallic workflow, in one of the forms."""
    if form == "free":
        return _free(wanted)
    plain = _plain(wanted)
    if form == "plain":
        return plain
    tried = _Tried.of(wanted, ErrorWeights.at(wanted.roughness), plain.metallic, plain.dielectric)
    return Metallic(tried.base, plain.metallic, plain.dielectric)


def _plain(wanted: MetallicAim) -> Metallic:
    """The plain form: exact diffuse albedo; metallic by bisection for the mean F0."""
    specular = mean_channel(wanted.specular)
    dielectric = np.clip(specular, wanted.lowest, wanted.highest).astype(np.float32)
    allowed = np.clip((specular - FIRST_METAL) / (SURE_METAL - FIRST_METAL), 0.0, 1.0)
    low, high = np.zeros_like(specular), np.ones_like(specular)
    if (allowed > 0.0).any():
        for _ in range(_HALVINGS):
            middle = (low + high) / 2.0
            base = _diffuse_base(wanted, middle).mean(axis=-1)
            f0 = wanted.highest * (1.0 - middle) + middle * base
            low, high = np.where(f0 < specular, middle, low), np.where(f0 < specular, high, middle)
    metallic = np.where(specular > wanted.highest, high * allowed, 0.0).astype(np.float32)
    return Metallic(_diffuse_base(wanted, metallic), metallic, dielectric)


def _diffuse_base(wanted: MetallicAim, metallic: Picture) -> Picture:
    """Base colour for the diffuse albedo; where that is black, for F0."""
    rest = (wanted.below * (1.0 - metallic))[..., None]
    black = wanted.diffuse.max(axis=-1, keepdims=True) < 1e-4
    base = np.where(black, rgb(wanted.specular), wanted.diffuse / np.maximum(rest, 1e-6))
    return np.clip(base, 0.0, 1.0).astype(np.float32)


def _free(wanted: MetallicAim) -> Metallic:
    """The free form: line search over metallic, base and dielectric by least squares."""
    weights = ErrorWeights.at(wanted.roughness)
    metallic = np.zeros_like(wanted.roughness)
    best = _Tried.of(wanted, weights, metallic)
    steps = [np.full_like(metallic, step / _FIRST_STEPS) for step in range(1, _FIRST_STEPS + 1)]
    for step in steps:
        metallic, best = best.or_better(_Tried.of(wanted, weights, step), metallic, step)
    width = np.float32(1.0 / _FIRST_STEPS)
    for _ in range(_FINER):
        width /= 2.0
        middle = metallic
        for step in (middle - width, middle + width):
            step = np.clip(step, 0.0, 1.0)
            metallic, best = best.or_better(_Tried.of(wanted, weights, step), metallic, step)
    return Metallic(best.base, metallic, best.dielectric)


@dataclass(frozen=True)
class _Tried:
    """Base colour and dielectric F0 for a given metallic, and the squared error (H, W)."""

    base: Picture
    dielectric: Picture
    off: Picture

    @staticmethod
    def of(
        wanted: MetallicAim,
        weights: ErrorWeights,
        metallic: Picture,
        dielectric: Picture | None = None,
    ) -> _Tried:
        """Solve by weighted least squares: both equations are linear in base and dielectric."""
        rest = np.float32(1.0) - metallic
        below = np.float32(wanted.below) * rest
        f0 = rgb(wanted.specular)
        if dielectric is None:
            # Eliminate the base colour: metallic diffuse = below (F0 - dielectric rest).
            mean = below * f0.mean(axis=-1) - metallic * wanted.diffuse.mean(axis=-1)
            dielectric = np.clip(
                mean / np.maximum(below * rest, 1e-6), wanted.lowest, wanted.highest
            ).astype(np.float32)
        diffused, mirrors = weights.diffuse * below, weights.specular * metallic
        diffuse = weights.diffuse[..., None] * wanted.diffuse
        specular = weights.specular[..., None] * (f0 - (dielectric * rest)[..., None])
        both = weights.together
        size = diffused**2 + 2.0 * both * diffused * mirrors + mirrors**2
        along = (diffused + both * mirrors)[..., None] * diffuse
        along += (mirrors + both * diffused)[..., None] * specular
        base = np.clip(along / np.maximum(size, 1e-12)[..., None], 0.0, 1.0).astype(np.float32)
        more, brighter = diffused[..., None] * base - diffuse, mirrors[..., None] * base - specular
        off = more**2 + 2.0 * both[..., None] * more * brighter + brighter**2
        return _Tried(base, dielectric, off.sum(axis=-1))

    def or_better(
        self, other: _Tried, metallic: Picture, others: Picture
    ) -> tuple[Picture, _Tried]:
        """Per texel, the candidate with the smaller error, and its metallic."""
        nearer = other.off < self.off - _BETTER
        chosen = _Tried(
            np.where(nearer[..., None], other.base, self.base),
            np.where(nearer, other.dielectric, self.dielectric),
            np.where(nearer, other.off, self.off),
        )
        return np.where(nearer, others, metallic), chosen
