"""Fit parameters to a target's shading model, so that it renders matcap's reflectance.

Shading models differ: a specular layer darkens the diffuse part, Disney's diffuse lobe is not
Lambert's, Unity's mobile term is twice as bright on polished surfaces. For a flat surface the
difference depends on roughness and F0 alone. Once a target, over a grid of both, three factors (on
diffuse albedo, F0 and roughness) minimise the difference of reflected light under the directions of
the residual (surface.py). Textures are written with these factors; the remaining difference is the
residual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from matcap.export.formats import Picture, brightest_channel, mean_channel
from matcap.export.shading import MATCAP, Geometry, TargetShading, diffuse_lobe, specular_lobe
from matcap.export.surface import DIRECTIONS

_ROUGH, _F0 = 64, 33
# Factors on roughness that are tried where the target's lobe has another shape ("mobile").
_RATIOS = np.linspace(0.7, 1.3, 61)
_ROUNDS = 4  # fixed-point iterations, which converge to 1e-4
_LEANING, _LEAN = 512, 30.0  # number of tilted normals, and their largest tilt in degrees
_MOST_TOGETHER = 0.9  # largest correlation of diffuse and specular errors in ErrorWeights
_LEAST = 0.02  # least roughness of the grid: narrower highlights fall between the directions


@dataclass(frozen=True)
class FittedTables:
    """(64, 33) tables of factors: rows by roughness, columns by sqrt(F0), uniform in [0, 1]."""

    diffuse: Picture
    """Factor on the diffuse albedo."""
    specular: Picture
    """Factor on F0."""
    roughness: Picture
    """Factor on the roughness."""

    each: bool = False
    """The layer darkens each channel by its own reflection; else all by the brightest one's."""

    def albedo(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W, 1 or 3) factors on diffuse albedo; f0 (H, W[, 3]), roughness (H, W)."""
        taken = f0 if self.each else brightest_channel(f0)
        factor = self._at(self.diffuse, taken, roughness)
        return factor if factor.ndim == 3 else factor[..., None]

    def f0(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W[, 3]) F0 to write; may exceed 1."""
        return f0 * self._at(self.specular, f0, roughness)

    def rough(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W) roughness to write."""
        factor = self._at(self.roughness, mean_channel(f0), roughness)
        return np.clip(roughness * factor, 0.0, 1.0)

    @staticmethod
    def _at(table: Picture, f0: Picture, roughness: Picture) -> Picture:
        import cv2

        if np.ptp(table) < 1e-5:  # most tables are 1 throughout
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
    """Weights of errors of diffuse albedo and F0, by the light that each reflects."""

    diffuse: Picture
    """(H, W) mean reflected light of diffuse albedo 1, under irradiance 1."""
    specular: Picture
    """(H, W) mean reflected light of F0 = 1."""
    together: Picture
    """(H, W) overlap of both over directions, [0, 1): errors of opposite sign cancel that much."""

    @staticmethod
    def at(roughness: Picture) -> ErrorWeights:
        """The weights at (H, W) roughness."""
        place = np.rint(np.clip(roughness, 0.0, 1.0) * (_ROUGH - 1)).astype(np.intp)
        return ErrorWeights(*(table[place] for table in _light()))


@lru_cache(maxsize=1)
def _light() -> tuple[Picture, Picture, Picture]:
    """ErrorWeights by roughness, over tilted normals and all DIRECTIONS."""
    rough = torch.linspace(0.0, 1.0, _ROUGH, dtype=torch.float64).clamp_min(_LEAST)[None, :, None]
    number = torch.arange(_LEANING, dtype=torch.float64) + 0.5
    up = 1.0 - (1.0 - math.cos(math.radians(_LEAN))) * number / _LEANING  # uniform over the cap
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
    """The tables of a target; all 1 if its shading is matcap's."""
    rough = torch.linspace(0.0, 1.0, _ROUGH, dtype=torch.float64).clamp_min(_LEAST)
    f0 = torch.linspace(0.0, 1.0, _F0, dtype=torch.float64).square().clamp_min(1e-4)
    rough, f0 = (v[None].contiguous() for v in torch.meshgrid(rough, f0, indexing="ij"))
    flat = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None]
    flat = flat.expand(3, _ROUGH, _F0)
    places = [Geometry.of(flat, *pair) for pair in DIRECTIONS]
    factor, ratio = _nearest(shading, places, f0, rough)
    nearest = (rough * ratio).clamp(max=1.0)
    # The layer reflects the F0 that is written.
    layer = (f0 * factor).clamp(max=1.0)
    meant = torch.stack([diffuse_lobe(MATCAP, at, rough, None) * at.light for at in places])
    shown = torch.stack([diffuse_lobe(shading, at, nearest, layer) * at.light for at in places])
    albedo = meant.sum(0) / shown.sum(0).clamp_min(1e-6)
    tables = [table[0].numpy().astype(np.float32) for table in (albedo, factor, ratio)]
    return FittedTables(tables[0], tables[1], tables[2], shading.each)


def _nearest(
    shading: TargetShading, places: list[Geometry], f0: Tensor, rough: Tensor
) -> tuple[Tensor, Tensor]:
    """(factor on F0, factor on roughness) with the least difference, for each grid point."""
    meant = torch.stack([specular_lobe(MATCAP, at, f0, 1.0, rough) * at.light for at in places])
    best = torch.full_like(f0, torch.inf)
    factor, chosen = torch.ones_like(f0), torch.ones_like(f0)
    # 1 first: it is kept where no other ratio is better.
    ratios = _RATIOS if shading.specular == "mobile" else np.ones(1)
    for ratio in sorted(ratios, key=lambda one: abs(one - 1.0)):
        tried = (rough * float(ratio)).clamp(max=1.0)
        scale = torch.ones_like(f0)
        # Multiple scattering is quadratic in F0: iterate.
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
