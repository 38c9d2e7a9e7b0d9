"""The reflectance that a target renders, and its error against matcap's.

A TargetSurface holds the maps as a target's files hold them, rounding included, and how the target
shades (shading.py). Read next: fit.py, which fits the parameters for a target such that little
differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.export.formats import Picture
from matcap.export.job import ExportJob
from matcap.export.shading import MATCAP, Geometry, TargetShading, diffuse_lobe, specular_lobe
from matcap.export.texture_file import TextureFile

# Directions under which surfaces are compared, degrees: view and light from the vertical, and the
# light around it.
_VIEWS = (0.0, 45.0)
_LIGHTS = (15.0, 40.0, 65.0)
_AROUND = (0.0, 90.0, 180.0, 270.0)
# At most about this many texels are compared, evenly spread.
_TEXELS = 65_536
_FEW_TEXELS = 4_096


@dataclass(frozen=True)
class TargetSurface:
    """Parameters of a target's reflectance, per texel."""

    diffuse: Tensor
    """(3, H, W)."""
    f0: Tensor
    """(1, H, W) or (3, H, W) reflectance at normal incidence."""
    roughness: Tensor
    """(1, H, W); alpha is its square."""
    normal: Tensor
    """(3, H, W), +Y up; need not be of unit length."""
    f90: float | Tensor = 1.0
    """Reflectance at grazing, a number or a tensor like f0."""
    layer: float | Tensor | None = None
    """F0 of a layer above the diffuse part, where the target's shading has one; a number or a
    tensor like f0."""
    shading: TargetShading = MATCAP
    """Of the target."""
    metal: Tensor | None = None
    """(1 or 3, H, W) F0 of the part that is metal, where that is another lobe."""
    share: Tensor | None = None
    """(1, H, W) of that part; `f0` is of the rest."""

    @staticmethod
    def of_maps(maps: MapSet) -> TargetSurface:
        """What matcap means by a map set."""
        return TargetSurface(maps.diffuse, maps.specular, maps.roughness, maps.normal)

    def every(self, step: int) -> TargetSurface:
        """Every step-th texel of every step-th row, in float64."""

        def thin(value: Any) -> Any:  # noqa: ANN401
            return value[..., ::step, ::step].double() if isinstance(value, Tensor) else value

        return TargetSurface(
            **{field.name: thin(getattr(self, field.name)) for field in fields(self)}
        )

    def shine(self, to_light: Tensor, to_view: Tensor) -> Tensor:
        """(3, H, W) reflectance times n.l; 0 where light or view is below the surface.

        Args:
            to_light, to_view: (3, H, W) or (3, 1, 1) unit vectors.
        """
        at = Geometry.of(self.normal, to_light, to_view)
        below = self.diffuse * diffuse_lobe(self.shading, at, self.roughness, self.layer)
        above = specular_lobe(self.shading, at, self.f0, self.f90, self.roughness)
        if self.metal is not None and self.share is not None:
            bare = replace(self.shading, index=None)
            metal = specular_lobe(bare, at, self.metal, 1.0, self.roughness)
            above = above * (1.0 - self.share) + metal * self.share
        value = (below + above) * at.light
        return torch.where(at.above > 0, value, torch.zeros_like(value))


# What a target reads from a texture: (C, H, W) float64.
Reader = Callable[[TextureFile], Tensor]
MadeSurface = Callable[[Reader], TargetSurface]


@dataclass(frozen=True)
class Residual:
    """How far a target's light is from matcap's, as a share of matcap's light."""

    mean: float
    """Over all texels, views and lights."""
    worst: float
    """Of any one view and light, over all texels."""

    def __str__(self) -> str:
        return f"{self.mean:.2%} of the light on average, {self.worst:.2%} at worst"


def thinning(width: int, height: int, texels: int = _TEXELS) -> int:
    """The step between the texels of a map set that are compared."""
    return max(1, math.ceil(math.sqrt(width * height / texels)))


def residual(maps: MapSet, surface: TargetSurface) -> Residual:
    """How far a target's surface is from what matcap means by the maps.

    Reflected radiance of both, straight from above and at 45 degrees, under lights 15, 40 and 65
    degrees from the vertical on four sides; absolute differences, summed over at most about
    65,000 evenly spread texels, divided by matcap's sum.
    """
    step = thinning(*maps.size)
    return _compared(_lit(TargetSurface.of_maps(maps).every(step)), surface.every(step))


def _lit(surface: TargetSurface) -> list[Tensor]:
    """A surface under every pair of directions."""
    return [surface.shine(*directions) for directions in DIRECTIONS]


def _compared(meant: list[Tensor], theirs: TargetSurface) -> Residual:
    """The residual of every texel of a surface, in float64, from what is meant."""
    off, total, worst = 0.0, 0.0, 0.0
    for directions, true in zip(DIRECTIONS, meant, strict=True):
        error = float((theirs.shine(*directions) - true).abs().sum())
        light = float(true.sum())
        off, total = off + error, total + light
        worst = max(worst, error / light if light > 0.0 else 0.0)
    return Residual(off / total if total > 0.0 else 0.0, worst)


def residuals(
    job: ExportJob, surfaces: Mapping[str, MadeSurface], texels: int = _TEXELS
) -> dict[str, Residual]:
    """How far what a target reads is from what the maps mean, over evenly spread texels.

    Args:
        job: the maps.
        surfaces: what the target makes of textures, by name.
        texels: at most about so many are compared.
    """
    step = thinning(*job.maps.size, texels)
    piece = job.piece(slice(None, None, step), slice(None, None, step))
    seen: dict[int, tuple[TextureFile, Tensor]] = {}

    def read(texture: TextureFile) -> Tensor:
        if id(texture) not in seen:
            seen[id(texture)] = texture, _channels(texture.seen(piece))
        return seen[id(texture)][1]

    kinds = ("diffuse", "specular", "roughness", "normal")
    diffuse, specular, roughness, normal = (_channels(piece.picture(kind)) for kind in kinds)
    meant = _lit(TargetSurface(diffuse, specular, roughness, normal))
    return {name: _compared(meant, made(read)) for name, made in surfaces.items()}


def nearest(job: ExportJob, surfaces: Sequence[MadeSurface], margin: float = 0.0) -> int:
    """Which of several surfaces is nearest to what the maps mean, over a few texels.

    Args:
        job: the maps.
        surfaces: what the target makes of textures.
        margin: share of its residual by which another than the first must be nearer.
    """
    named = {str(key): made for key, made in enumerate(surfaces)}
    means = [one.mean for one in residuals(job, named, _FEW_TEXELS).values()]
    best = min(range(len(means)), key=means.__getitem__)
    return best if means[best] < (1.0 - margin) * means[0] else 0


def _channels(values: Picture) -> Tensor:
    """(C, H, W) float64."""
    tensor = torch.from_numpy(np.ascontiguousarray(values)).double()
    return tensor[None] if tensor.ndim == 2 else tensor.movedim(-1, 0)


def _direction(tilt: float, around: float) -> Tensor:
    """(3, 1, 1) unit vector at an angle from +z, turned about it; degrees."""
    t, a = math.radians(tilt), math.radians(around)
    vector = (math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t))
    return torch.tensor(vector, dtype=torch.float64)[:, None, None]


# (to_light, to_view) of every comparison.
DIRECTIONS: tuple[tuple[Tensor, Tensor], ...] = tuple(
    (_direction(tilt, around), _direction(view, 0.0))
    for view in _VIEWS
    for tilt in _LIGHTS
    for around in _AROUND
)
