"""Parameters fitted to a target's shading model so that it shows the intended reflectance.

Where a target shades otherwise than matcap, the same numbers give another light: a layer darkens
what lies below it, Disney's diffuse lobe is not Lambert's, Unity's mobile term is twice as bright
on polished surfaces. How much so depends on roughness and F0 alone, for a surface that lies flat.
So once a target, over a grid of both, these are found: the factor on the diffuse albedo, the factor
on F0, and the roughness that leave the least difference of light under the directions by which
residuals are measured (surface.py). Textures are made with them; what is left is the residual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import torch

from matcap.export.formats import Picture, brightest_channel, mean_channel
from matcap.export.shading import MATCAP, Geometry, TargetShading, diffuse_lobe, specular_lobe
from matcap.export.surface import DIRECTIONS

if TYPE_CHECKING:
    from torch import Tensor

_ROUGH, _F0 = 64, 33
# Roughnesses that are tried, relative to the one that is meant, where the highlight has another
# shape; all others keep it.
_RATIOS = np.linspace(0.7, 1.3, 61)
_ROUNDS = 4  # of Newton's kind, until factors stand to 1e-4
_LEANING, _LEAN = 512, 30.0  # surfaces that lean by up to so many degrees
_MOST_TOGETHER = 0.9  # more, and a wrong diffuse would count nothing beside a wrong F0
_LEAST = 0.02  # of the grid's roughness: below it a highlight is narrower than the directions


@dataclass(frozen=True)
class FittedTables:
    """Tables over roughness (rows, even from 0 to 1) and the root of F0 (columns, likewise)."""

    diffuse: Picture
    """Factor on the diffuse albedo."""
    specular: Picture
    """Factor on F0."""
    roughness: Picture
    """Factor on the roughness."""

    each: bool = False
    """A layer takes from every channel what it reflects there; else, what it reflects of the
    brightest."""

    def albedo(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W, 1 or 3) factors on the diffuse albedo, of (H, W[, 3]) F0 and (H, W) roughness."""
        taken = f0 if self.each else brightest_channel(f0)
        factor = self._at(self.diffuse, taken, roughness)
        return factor if factor.ndim == 3 else factor[..., None]

    def f0(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W[, 3]) the F0 to write, as many channels as it has; may exceed 1."""
        return f0 * self._at(self.specular, f0, roughness)

    def rough(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W) the roughness to write."""
        factor = self._at(self.roughness, mean_channel(f0), roughness)
        return np.clip(roughness * factor, 0.0, 1.0)

    @staticmethod
    def _at(table: Picture, f0: Picture, roughness: Picture) -> Picture:
        import cv2

        if np.ptp(table) < 1e-5:  # most tables say 1 throughout
            return np.full_like(f0, table.flat[0])
        if f0.ndim == 3:
            by_channel = (FittedTables._at(table, one, roughness) for one in np.moveaxis(f0, -1, 0))
            return np.stack(list(by_channel), axis=-1)
        y = np.clip(roughness, 0.0, 1.0) * np.float32(_ROUGH - 1)
        x = np.sqrt(np.clip(f0, 0.0, 1.0)) * np.float32(_F0 - 1)
        factors = cv2.remap(table, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(factors, dtype=np.float32)


@dataclass(frozen=True)
class ErrorWeights:
    """What light shows of a surface: how much an error of its numbers counts."""

    diffuse: Picture
    """(H, W) mean light of a diffuse albedo of 1, of the surface lit by 1."""
    specular: Picture
    """(H, W) the same of an F0 of 1."""
    together: Picture
    """(H, W) in [0, 1): how much of both comes under the same directions, where errors of one may
    make up for the other's."""

    @staticmethod
    def at(roughness: Picture) -> ErrorWeights:
        """Of (H, W) roughness."""
        place = np.rint(np.clip(roughness, 0.0, 1.0) * (_ROUGH - 1)).astype(np.intp)
        return ErrorWeights(*(table[place] for table in _light()))


@lru_cache(maxsize=1)
def _light() -> tuple[Picture, Picture, Picture]:
    """ErrorWeights over roughness, of surfaces that lean in all ways under all DIRECTIONS."""
    rough = torch.linspace(0.0, 1.0, _ROUGH, dtype=torch.float64).clamp_min(_LEAST)[None, :, None]
    number = torch.arange(_LEANING, dtype=torch.float64) + 0.5
    up = 1.0 - (1.0 - math.cos(math.radians(_LEAN))) * number / _LEANING  # even over the cap
    turn, out = math.pi * (1.0 + 5.0**0.5) * number, (1.0 - up.square()).sqrt()
    normals = torch.stack([out * turn.cos(), out * turn.sin(), up])[:, None, :]
    shown, mirrored = [], []
    for directions in DIRECTIONS:
        at = Geometry.of(normals, *directions)
        lit = at.light * at.above
        shown.append((diffuse_lobe(MATCAP, at, rough, None) * lit).expand(1, _ROUGH, -1))
        mirrored.append(specular_lobe(MATCAP, at, torch.ones_like(rough), 1.0, rough) * lit)
    diffuse, specular = (torch.cat(one).movedim(1, 0).flatten(1) for one in (shown, mirrored))
    means = diffuse.mean(1), specular.mean(1)
    relative = torch.minimum(diffuse / means[0][:, None], specular / means[1][:, None])
    together = relative.mean(1).clamp(max=_MOST_TOGETHER)
    planes = (one.numpy().astype(np.float32) for one in (*means, together))
    return next(planes), next(planes), next(planes)


@lru_cache(maxsize=64)
def fitted_tables(shading: TargetShading) -> FittedTables:
    """The tables of a target; all the same numbers where it shades as matcap does."""
    rough = torch.linspace(0.0, 1.0, _ROUGH, dtype=torch.float64).clamp_min(_LEAST)
    f0 = torch.linspace(0.0, 1.0, _F0, dtype=torch.float64).square().clamp_min(1e-4)
    rough, f0 = (v[None].contiguous() for v in torch.meshgrid(rough, f0, indexing="ij"))
    flat = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None]
    flat = flat.expand(3, _ROUGH, _F0)
    places = [Geometry.of(flat, *pair) for pair in DIRECTIONS]
    factor, ratio = _nearest(shading, places, f0, rough)
    nearest = (rough * ratio).clamp(max=1.0)
    # The layer is as bright as the F0 that is written.
    layer = (f0 * factor).clamp(max=1.0)
    meant = torch.stack([diffuse_lobe(MATCAP, at, rough, None) * at.light for at in places])
    shown = torch.stack([diffuse_lobe(shading, at, nearest, layer) * at.light for at in places])
    albedo = meant.sum(0) / shown.sum(0).clamp_min(1e-6)
    tables = [table[0].numpy().astype(np.float32) for table in (albedo, factor, ratio)]
    return FittedTables(tables[0], tables[1], tables[2], shading.each)


def _nearest(
    shading: TargetShading, places: list[Geometry], f0: Tensor, rough: Tensor
) -> tuple[Tensor, Tensor]:
    """(factor on F0, factor on roughness) of the least difference at every point of the grid."""
    meant = torch.stack([specular_lobe(MATCAP, at, f0, 1.0, rough) * at.light for at in places])
    best = torch.full_like(f0, torch.inf)
    factor, chosen = torch.ones_like(f0), torch.ones_like(f0)
    # The one that is meant goes first: it stays where no other is better.
    ratios = _RATIOS if shading.specular == "mobile" else np.ones(1)
    for ratio in sorted(ratios, key=lambda one: abs(one - 1.0)):
        tried = (rough * float(ratio)).clamp(max=1.0)
        scale = torch.ones_like(f0)
        # What bounces between microfacets grows with the square of F0.
        for _ in range(_ROUNDS if shading.compensated else 1):
            shown = torch.stack(
                [specular_lobe(shading, at, f0 * scale, 1.0, tried) * at.light for at in places]
            )
            step = meant.sum(0) / shown.sum(0).clamp_min(1e-9)
            scale = scale * step
        off = (meant - step * shown).abs().sum(0)
        better = off < best * (1.0 - 1e-6)
        best = torch.where(better, off, best)
        factor = torch.where(better, scale, factor)
        chosen = torch.where(better, ratio * torch.ones_like(f0), chosen)
    return factor, chosen
