"""Shading models of targets where they differ from matcap's, and the residual they leave."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from matcap.brdf.cook_torrance import MIN_ROUGHNESS, dot, ggx, normalize, smith_visibility
from matcap.export.job import ExportJob, Picture
from matcap.export.texture_file import TextureFile
from matcap.relight.effects.multiscatter import albedo

# Targets differ from brdf/cook_torrance.py in masking, diffuse lobe, Fresnel, and whether the
# specular layer darkens the diffuse part: the properties of TargetShading. Sources:
#
# - glTF 2.0, appendix B: the diffuse part is multiplied by 1 - F(v.h) of the brightest channel.
#   UsdPreviewSurface 2.6: of each channel; its metals have their own colour at grazing.
# - MaterialX 1.39 (OpenPBR, standard_surface), Unreal's Substrate: multiplied by 1 - directional
#   albedo of the layer; multiple scattering is compensated [turquin2019, eq. 16].
# - Unreal, Godot: an approximation of height-correlated Smith [hammon2017, slide 83]; F90 falls to
#   0 with F0 below 0.02 [lazarov2013].
# - Unity HDRP: Disney's diffuse [burley2012, eq. 4], divided by 1.03571.
# - Unity URP: visibility and Fresnel in one term [zioma2015].

_DISNEY = 1.0 / 1.03571  # Unity's normalisation
_FADING = 50.0  # F90 = min(50 F0, 1) [lazarov2013]
_LEAST_URP = 0.0078125  # URP's smallest alpha: HALF_MIN_SQRT
_LEAST_URP_COSINE = 0.1  # of (l.h)^2


@dataclass(frozen=True)
class TargetShading:
    """Shading model of a target."""

    specular: Literal["microfacet", "mobile"] = "microfacet"
    """D G F / (4 (n.l)(n.v)) with GGX ("microfacet"), or Unity URP's term ("mobile")."""
    masking: Literal["correlated", "separable", "hammon"] = "correlated"
    """Height-correlated Smith, separable Smith, or Hammon's approximation."""
    diffuse: Literal["lambert", "disney"] = "lambert"
    """Lambert's or Disney's diffuse lobe."""
    index: float | None = None
    """F0 of one index of refraction for all texels, whose exact Fresnel is tinted to each texel's
    F0, and whose albedo darkens the diffuse part; None is Schlick's Fresnel."""
    layer: Literal["half", "albedo"] | None = None
    """Factor on the diffuse part: 1 - F(v.h) ("half"), 1 - directional albedo, or 1 (None)."""
    each: bool = False
    """... of each channel; else of the brightest one."""
    compensated: bool = False
    """Multiple scattering is compensated."""
    fading: bool = False
    """F90 falls from 1 to 0 with F0 below 0.02."""
    conductor: bool = False
    """Fresnel's equations of a conductor with that F0 and a white edge, as in standard_surface
    [gulbrandsen2014], instead of Schlick's."""


MATCAP = TargetShading()
# Of glTF's viewers: three.js, Babylon.js and Blender add multiple scattering.
GLTF = TargetShading(layer="half", compensated=True)


@dataclass(frozen=True)
class Geometry:
    """Cosines of a surface for light and view, (..., 1, H, W) each; (...) are several lights."""

    light: Tensor
    """n.l, clamped to 0."""
    view: Tensor
    """n.v, clamped to 0."""
    half: Tensor
    """n.h, cosine of normal and half vector."""
    difference: Tensor
    """v.h, cosine of view and half vector."""
    above: Tensor
    """1 where light and view are above the surface, else 0."""

    @staticmethod
    def of(normal: Tensor, to_light: Tensor, to_view: Tensor) -> Geometry:
        """Cosines of normals (3, H, W) of any length with unit vectors (..., 3, H or 1, W or 1)."""
        normal, half = normalize(normal), normalize(to_light + to_view)
        light, view = dot(normal, to_light), dot(normal, to_view)
        above = ((light > 0) & (view > 0)).to(light.dtype)
        return Geometry(
            light.clamp_min(0.0), view.clamp_min(0.0), dot(normal, half), dot(to_view, half), above
        )

    @cached_property
    def grazing(self) -> Tensor:
        """Schlick's (1 - v.h)^5."""
        return (1.0 - self.difference).clamp(0.0, 1.0) ** 5


def diffuse_lobe(
    shading: TargetShading, at: Geometry, roughness: Tensor, layer: float | Tensor | None
) -> Tensor:
    """Diffuse BRDF over albedo, in 1/sr; `layer`: F0 of the specular layer above, or None."""
    value = torch.full_like(at.light, 1.0 / math.pi)
    if shading.diffuse == "disney":
        edge = roughness * (2.0 * at.difference.square()) - 0.5  # fd90 - 1, with l.v = 2 v.h^2 - 1
        for cosine in (at.light, at.view):
            value = value * (1.0 + edge * (1.0 - cosine).clamp(0.0, 1.0) ** 5)
        value = value * _DISNEY
    if layer is None or shading.layer is None:
        return value
    f0 = torch.as_tensor(layer if shading.index is None else shading.index, dtype=value.dtype)
    f0 = f0.expand_as(value) if f0.ndim == 0 else f0
    f0 = f0 if shading.each else f0.amax(dim=-3, keepdim=True)
    if shading.layer == "half":
        taken = f0 + (1.0 - f0) * at.grazing
    else:
        bias, total = directional_albedo(roughness, at.view)
        taken = f0 * (total - bias) + bias
        if shading.compensated:
            taken = taken * (1.0 + f0 * (1.0 - total) / total)
    return value * (1.0 - taken).clamp_min(0.0)


def specular_lobe(
    shading: TargetShading, at: Geometry, f0: Tensor, f90: float | Tensor, roughness: Tensor
) -> Tensor:
    """Specular BRDF, in 1/sr, without n.l."""
    if shading.specular == "mobile":
        return _mobile(at, f0, roughness)
    alpha = roughness.clamp_min(MIN_ROUGHNESS).square()
    spread = ggx(at.half, (1.0 - at.half.square()).clamp_min(0.0), alpha)
    fresnel = _fresnel(shading, at, f0, f90)
    value = spread * _visibility(shading, at, alpha) * fresnel
    if shading.compensated:
        _, total = directional_albedo(roughness, at.view)
        back = fresnel if shading.index is None else torch.full_like(f0, shading.index)
        value = value * (1.0 + back * (1.0 - total) / total)
    return value


def _fresnel(shading: TargetShading, at: Geometry, f0: Tensor, f90: float | Tensor) -> Tensor:
    if shading.index is not None:
        return f0 / shading.index * _dielectric(at, shading.index)
    if shading.conductor:
        return _conductor(at, f0)
    if shading.fading:
        f90 = f90 * (_FADING * f0.amax(dim=-3, keepdim=True)).clamp(max=1.0)
    return f0 + (f90 - f0) * at.grazing


def _dielectric(at: Geometry, f0: float) -> Tensor:
    """Fresnel's equations of a dielectric with that F0 [cook1982, eq. 5]."""
    root = math.sqrt(f0)
    c = at.difference.clamp(0.0, 1.0)
    g = (((1.0 + root) / (1.0 - root)) ** 2 - 1.0 + c.square()).sqrt()
    edge = ((c * (g + c) - 1.0) / (c * (g - c) + 1.0)).square()
    return 0.5 * ((g - c) / (g + c)).square() * (1.0 + edge)


def _conductor(at: Geometry, f0: Tensor) -> Tensor:
    """Fresnel's equations of a conductor with that F0 and the least index [gulbrandsen2014].

    n = (1 - F0) / (1 + F0), k from F0; F0 is clamped to 0.99.
    """
    r = f0.clamp(0.0, 0.99)
    n2 = ((1.0 - r) / (1.0 + r)).square()
    k2 = ((n2.sqrt() + 1.0).square() * r - (n2.sqrt() - 1.0).square()).clamp_min(0.0) / (1.0 - r)
    c = at.difference.clamp(0.0, 1.0)
    c2, s2 = c.square(), 1.0 - c.square()
    t0 = n2 - k2 - s2
    both = (t0.square() + 4.0 * n2 * k2).sqrt()
    a = (0.5 * (both + t0)).clamp_min(0.0).sqrt()
    upright = (both + c2 - 2.0 * a * c) / (both + c2 + 2.0 * a * c)
    first, second = c2 * both + s2.square(), 2.0 * a * c * s2
    return 0.5 * upright * (1.0 + (first - second) / (first + second).clamp_min(1e-9))


def _visibility(shading: TargetShading, at: Geometry, alpha: Tensor) -> Tensor:
    if shading.masking == "correlated":
        return smith_visibility(at.light, at.view, alpha)
    if shading.masking == "hammon":
        both = 2.0 * at.light * at.view
        return 0.5 / (both + (at.light + at.view - both) * alpha).clamp_min(1e-7)

    def one(cosine: Tensor) -> Tensor:
        squared = alpha.square()
        return 1.0 / (cosine + torch.sqrt(squared + (1.0 - squared) * cosine.square()))

    return one(at.light) * one(at.view)


def _mobile(at: Geometry, f0: Tensor, roughness: Tensor) -> Tensor:
    alpha = roughness.square().clamp_min(_LEAST_URP)
    spread = at.half.clamp_min(0.0).square() * (alpha.square() - 1.0) + 1.00001
    folded = at.difference.square().clamp_min(_LEAST_URP_COSINE) * (4.0 * alpha + 2.0)
    return f0 * (alpha / spread).square() / folded / math.pi


def directional_albedo(roughness: Tensor, cosine: Tensor) -> tuple[Tensor, Tensor]:
    """(bias, total) of the lobe's directional albedo, F0 (total - bias) + bias [karis2013].

    Args:
        roughness, cosine: (1, H, W) each; n.v, of one view.
    """
    roughness, cosine = torch.broadcast_tensors(roughness, cosine)
    tables = _tables().to(roughness.dtype)
    places = torch.stack([cosine.clamp(0.0, 1.0).sqrt(), roughness.clamp(0.0, 1.0)], dim=-1)
    looked_up = grid_sample(tables, 2.0 * places - 1.0, align_corners=True, padding_mode="border")
    return looked_up[:, 0], looked_up[:, 1].clamp_min(1e-3)


@lru_cache(maxsize=1)
def _tables() -> Tensor:
    """(1, 2, 64, 64) tables b and b + s of the albedo F0 s + b, by roughness and sqrt(n.v)."""
    made = albedo()
    return torch.stack([torch.from_numpy(made.bias), torch.from_numpy(made.total)])[None]


# The reflectance that a target renders from its files, and the residual against matcap's.
#
# A TargetSurface has the target's parameters as read from its files, rounding included.

# Directions of the residual, in degrees: angles of view and light to +z, azimuths of the light.
_VIEWS = (0.0, 45.0)
_LIGHTS = (15.0, 40.0, 65.0)
_AROUND = (0.0, 90.0, 180.0, 270.0)
# Largest number of texels that are compared, on a regular grid.
_TEXELS = 65_536
_FEW_TEXELS = 4_096  # to choose between variants
_AT_ONCE = 131_072  # texels times lights


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
    metal: Tensor | None = None
    """(1 or 3, H, W) F0 of the metallic part, where that is a lobe of its own."""
    share: Tensor | None = None
    """(1, H, W) weight of that lobe; `f0` has weight 1 - share."""

    def shine(self, to_light: Tensor, to_view: Tensor) -> Tensor:
        """(..., 3, H, W) BRDF times n.l; 0 where light or view is below the surface.

        Args:
            to_light: (..., 3, H, W) or (..., 3, 1, 1) unit vectors.
            to_view: (3, H, W) or (3, 1, 1) unit vectors.
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
        mean, worst = 100.0 * self.mean, 100.0 * self.worst
        return f"{mean:.2f} % of the light on average, {worst:.2f} % at worst"


def thinning(width: int, height: int, texels: int = _TEXELS) -> int:
    """Grid step with which at most `texels` texels of a map set are compared."""
    return max(1, math.ceil(math.sqrt(width * height / texels)))


def _together(surface: TargetSurface) -> Iterator[tuple[Tensor, Tensor]]:
    """(N, 3, 1, 1) lights and their view, as many at once as stay in a cache."""
    count = max(1, _AT_ONCE // surface.normal[0].numel())
    for start in range(0, len(DIRECTIONS), _A_VIEW):
        lights, views = zip(*DIRECTIONS[start : start + _A_VIEW], strict=True)
        for some in torch.stack(lights).split(count):
            yield some, views[0]


def shine_all(surface: TargetSurface) -> list[Tensor]:
    """BRDF n.l for all DIRECTIONS, (N, 3, H, W) of several lights each."""
    return [surface.shine(*directions) for directions in _together(surface)]


def compared(meant: list[Tensor], theirs: TargetSurface) -> Residual:
    """Residual of a surface against matcap's.

    Views at 0 and 45 degrees to +z, lights at 15, 40 and 65 degrees on four sides; the sum of
    absolute differences of BRDF n.l, divided by the sum of matcap's, `meant` (shine_all).
    """
    pairs = zip(_together(theirs), meant, strict=True)
    off = torch.cat([_sums((theirs.shine(*at) - true).abs_()) for at, true in pairs])
    light = torch.cat([_sums(true) for true in meant])
    total, shares = float(light.sum()), torch.where(light > 0.0, off / light, 0.0)
    return Residual(float(off.sum()) / total if total > 0.0 else 0.0, float(shares.max()))


def _sums(values: Tensor) -> Tensor:
    return values.flatten(1).sum(1)


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


# (to_light, to_view) pairs, _A_VIEW lights of a view after each other.
_A_VIEW = len(_LIGHTS) * len(_AROUND)
DIRECTIONS: tuple[tuple[Tensor, Tensor], ...] = tuple(
    (_direction(tilt, around), _direction(view, 0.0))
    for view in _VIEWS
    for tilt in _LIGHTS
    for around in _AROUND
)
