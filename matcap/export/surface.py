"""The reflectance that a target renders from its files, and the residual against matcap's.

A TargetSurface has the target's parameters as read from its files, rounding included, and its
shading model (shading.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from matcap.export.formats import Picture
from matcap.export.job import ExportJob
from matcap.export.shading import MATCAP, Geometry, TargetShading, diffuse_lobe, specular_lobe
from matcap.export.texture_file import TextureFile

# Directions of the residual, in degrees: angles of view and light to +z, azimuths of the light.
_VIEWS = (0.0, 45.0)
_LIGHTS = (15.0, 40.0, 65.0)
_AROUND = (0.0, 90.0, 180.0, 270.0)
# Largest number of texels that are compared, on a regular grid.
_TEXELS = 65_536
_FEW_TEXELS = 4_096  # to choose between variants


@dataclass(frozen=True)
class TargetSurface:
    """Parameters of a target's reflectance, per texel."""

    diffuse: Tensor
    """(3, H, W) diffuse albedo."""
    f0: Tensor
    """(1, H, W) or (3, H, W) reflectance at normal incidence."""
    roughness: Tensor
    """(1, H, W); alpha is its square."""
    normal: Tensor
    """(3, H, W), +Y up; need not be of unit length."""
    f90: float | Tensor = 1.0
    """Reflectance at grazing angles, a number or a tensor like f0."""
    layer: float | Tensor | None = None
    """F0 of the layer that darkens the diffuse part, a number or a tensor like f0."""
    shading: TargetShading = MATCAP
    """Shading model."""
    metal: Tensor | None = None
    """(1 or 3, H, W) F0 of the metallic part, where that is a lobe of its own."""
    share: Tensor | None = None
    """(1, H, W) weight of that lobe; `f0` has weight 1 - share."""

    def shine(self, to_light: Tensor, to_view: Tensor) -> Tensor:
        """(3, H, W) BRDF times n.l; 0 where light or view is below the surface.

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


# Reads a texture as the target does: (C, H, W) float64.
Reader = Callable[[TextureFile], Tensor]
MadeSurface = Callable[[Reader], TargetSurface]


@dataclass(frozen=True)
class Residual:
    """Absolute difference of reflected light, over matcap's light."""

    mean: float
    """Mean over all texels, views and lights."""
    worst: float
    """Mean over all texels for the pair of view and light with the largest residual."""

    def __str__(self) -> str:
        return f"{self.mean:.2%} of the light on average, {self.worst:.2%} at worst"


def thinning(width: int, height: int, texels: int = _TEXELS) -> int:
    """Grid step with which at most `texels` texels of a map set are compared."""
    return max(1, math.ceil(math.sqrt(width * height / texels)))


def shine_all(surface: TargetSurface) -> list[Tensor]:
    """BRDF n.l for all DIRECTIONS."""
    return [surface.shine(*directions) for directions in DIRECTIONS]


def compared(meant: list[Tensor], theirs: TargetSurface) -> Residual:
    """Residual of a surface against matcap's.

    Views at 0 and 45 degrees to +z, lights at 15, 40 and 65 degrees on four sides; the sum of
    absolute differences of BRDF n.l, divided by the sum of matcap's, `meant` (shine_all).
    """
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
    """Residuals of several surfaces, from the values that their textures store.

    Args:
        texels: largest number of texels that are compared.
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
    meant = shine_all(TargetSurface(diffuse, specular, roughness, normal))
    return {name: compared(meant, made(read)) for name, made in surfaces.items()}


def nearest(job: ExportJob, surfaces: Sequence[MadeSurface], margin: float = 0.0) -> int:
    """Index of the surface with the smallest mean residual, over _FEW_TEXELS texels.

    Args:
        margin: share of the first one's residual by which another must be smaller.
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
    """(3, 1, 1) unit vector at an angle to +z and an azimuth, in degrees."""
    t, a = math.radians(tilt), math.radians(around)
    vector = (math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t))
    return torch.tensor(vector, dtype=torch.float64)[:, None, None]


# (to_light, to_view) pairs.
DIRECTIONS: tuple[tuple[Tensor, Tensor], ...] = tuple(
    (_direction(tilt, around), _direction(view, 0.0))
    for view in _VIEWS
    for tilt in _LIGHTS
    for around in _AROUND
)
