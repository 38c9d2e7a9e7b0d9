"""Shading models of targets, where they differ from matcap's (brdf/cook_torrance.py).

Targets differ in a few ways only: which masking they know, which diffuse lobe, which Fresnel, and
whether what the specular layer reflects is taken from what lies below it. TargetShading says these
things of a target; one evaluation serves all of them. Sources:

- glTF 2.0, appendix B: the layer takes F(v.h) from the diffuse part, of the brightest channel;
  UsdPreviewSurface 2.6 of every channel, and its metals reflect their own colour at grazing.
- MaterialX 1.39 (OpenPBR, standard_surface), Unreal's Substrate: the layer takes its directional
  albedo, and what bounces between microfacets is given back (Turquin 2019, eq. 16).
- Unreal, Godot: Hammon's approximation of height-correlated Smith [hammon2017, slide 83];
  reflection fades below F0 = 0.02.
- Unity HDRP: Disney's diffuse (Burley 2012, eq. 4), divided by 1.03571.
- Unity URP: visibility and Fresnel as one term [karas2015].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from matcap.brdf.cook_torrance import MIN_ROUGHNESS, dot, ggx, normalize, smith_visibility

_DISNEY = 1.0 / 1.03571  # Unity's normalisation
_FADING = 50.0  # F0 times this is the reflection at grazing, where it fades (Lazarov 2013)
_LEAST_URP = 0.0078125  # URP's smallest alpha: HALF_MIN_SQRT
_LEAST_URP_COSINE = 0.1  # of (l.h)^2


@dataclass(frozen=True)
class TargetShading:
    """What a target does with diffuse, F0 and roughness."""

    specular: Literal["microfacet", "mobile"] = "microfacet"
    """GGX, masking and Fresnel ("microfacet"), or Unity URP's one term ("mobile")."""
    masking: Literal["correlated", "separable", "hammon"] = "correlated"
    """Height-correlated Smith, the product of both directions' ("separable"), or Hammon's
    approximation."""
    diffuse: Literal["lambert", "disney"] = "lambert"
    """Lambert's or Disney's lobe."""
    index: float | None = None
    """F0 of one index of refraction for all texels, whose exact Fresnel a tint scales down to
    theirs, and which the layer takes its albedo from; None for Schlick's Fresnel."""
    layer: Literal["half", "albedo"] | None = None
    """What is taken from the diffuse part: nothing, F(v.h) ("half") or the directional albedo of
    the specular part."""
    each: bool = False
    """Every channel by itself is what the layer takes; else the brightest is."""
    compensated: bool = False
    """What bounces between microfacets is added."""
    fading: bool = False
    """Reflection at grazing falls from 1 for F0 below 0.02."""
    conductor: bool = False
    """Fresnel's equations for a conductor of that F0 whose edge is white, where standard_surface
    finds its indices (Gulbrandsen 2014), instead of Schlick's Fresnel."""


MATCAP = TargetShading()


@dataclass(frozen=True)
class Geometry:
    """Cosines of a surface under one light from one view, (1, H, W) each."""

    light: Tensor
    """N.l, not below 0."""
    view: Tensor
    """N.v, not below 0."""
    half: Tensor
    """N.h."""
    difference: Tensor
    """V.h."""
    above: Tensor
    """1 where both are above the surface, else 0."""

    @staticmethod
    def of(normal: Tensor, to_light: Tensor, to_view: Tensor) -> Geometry:
        """Of (3, H, W) normals of any length, and unit vectors (3, H, W) or (3, 1, 1)."""
        normal, half = normalize(normal), normalize(to_light + to_view)
        light, view = dot(normal, to_light), dot(normal, to_view)
        above = ((light > 0) & (view > 0)).to(light.dtype)
        return Geometry(
            light.clamp_min(0.0), view.clamp_min(0.0), dot(normal, half), dot(to_view, half), above
        )

    @cached_property
    def grazing(self) -> Tensor:
        """(1 - v.h)^5, Schlick's."""
        return (1.0 - self.difference).clamp(0.0, 1.0) ** 5


def diffuse_lobe(
    shading: TargetShading, at: Geometry, roughness: Tensor, layer: float | Tensor | None
) -> Tensor:
    """What is seen of the diffuse albedo, in 1/sr; `layer` is the F0 of what lies above it."""
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
    """What is reflected at the surface, in 1/sr, without n.l."""
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
    """Fresnel's equations for a dielectric of that F0 (Cook and Torrance 1982, eq. 5)."""
    root = math.sqrt(f0)
    c = at.difference.clamp(0.0, 1.0)
    g = (((1.0 + root) / (1.0 - root)) ** 2 - 1.0 + c.square()).sqrt()
    edge = ((c * (g + c) - 1.0) / (c * (g - c) + 1.0)).square()
    return 0.5 * ((g - c) / (g + c)).square() * (1.0 + edge)


def _conductor(at: Geometry, f0: Tensor) -> Tensor:
    """Of n = (1 - F0) / (1 + F0), the least with which anything absorbing reflects F0."""
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
    """(bias, total): what of the light from one direction is reflected is F0 (total - bias) + bias.

    Args:
        roughness, cosine: of one shape, (1, H, W); cosine to the view.
    """
    roughness, cosine = torch.broadcast_tensors(roughness, cosine)
    tables = _tables().to(roughness.dtype)
    places = torch.stack([cosine.clamp(0.0, 1.0).sqrt(), roughness.clamp(0.0, 1.0)], dim=-1)
    looked_up = grid_sample(tables, 2.0 * places - 1.0, align_corners=True, padding_mode="border")
    return looked_up[:, 0], looked_up[:, 1].clamp_min(1e-3)


@lru_cache(maxsize=1)
def _tables() -> Tensor:
    """(1, 2, 64, 64): bias and total over roughness and the root of the cosine."""
    from matcap.relight.tables import albedo

    made = albedo()
    return torch.stack([torch.from_numpy(made.bias), torch.from_numpy(made.total)])[None]
