"""The Cook-Torrance microfacet reflectance matcap uses everywhere.

f = diffuse / pi + D G F / (4 (n.l)(n.v)), with GGX for D [walter2007, eq. 33], the
height-correlated Smith G [heitz2014, eq. 99] and Schlick's Fresnel from F0 to 1 [schlick1994,
eq. 15]; alpha = roughness squared. Multiple scattering between microfacets is left out here.

Two forms matter for stability in float32:

- D's denominator 1 - (n.h)^2 (1 - alpha^2) cancels near n.h = 1 for small alpha; it is computed as
  |n x h|^2 + (n.h)^2 alpha^2, two sums of non-negative terms.
- G / (4 (n.l)(n.v)) is computed as one term [heitz2014], so nothing divides by a grazing cosine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

# Roughness below this shows as this: alpha = 1e-6, whose square and whose peak D = 1 / (pi
# alpha^2) both stay far inside float32, and which no photograph or picture can distinguish from 0.
MIN_ROUGHNESS = 1e-3
SINGLE_ROUGHNESS = 0.05  # likewise of quick angles: a tenth of a per cent of alpha is float32's
LEAST_COSINE = 1e-3  # of quick angles

# Smallest denominator of the visibility term, reached only when both cosines are grazing.
_TINY = 1e-7

# Smallest denominator of D: below alpha^2 at MIN_ROUGHNESS, so reached only where there is no half
# vector, light and view being opposed.
_LEAST_SPREAD = 1e-14


def dot(a: Tensor, b: Tensor) -> Tensor:
    """(..., 1, H, W): scalar product along the channel dimension of (..., 3, H, W) vectors."""
    return (a * b).sum(dim=-3, keepdim=True)


def normalize(vector: Tensor) -> Tensor:
    """(..., 3, H, W) of unit length; a zero vector stays zero, with a zero gradient."""
    squared = dot(vector, vector)
    safe = torch.where(squared > 0, squared, torch.ones_like(squared))
    return vector * torch.where(squared > 0, torch.rsqrt(safe), torch.zeros_like(squared))


def ggx(n_dot_h: Tensor, n_cross_h_squared: Tensor, alpha: Tensor) -> Tensor:
    """GGX distribution of normals [walter2007, eq. 33], in 1/sr.

    Args:
        n_dot_h: cosine between normal and half vector.
        n_cross_h_squared: |n x h|^2, the squared sine, computed without cancellation.
        alpha: roughness squared, positive.
    """
    alpha_squared = alpha.square()
    spread = n_cross_h_squared + n_dot_h.square() * alpha_squared
    # (alpha / spread)^2 rather than alpha^2 / spread^2: the latter underflows first.
    return (alpha / spread.clamp_min(_LEAST_SPREAD)).square() / math.pi


def smith_visibility(n_dot_l: Tensor, n_dot_v: Tensor, alpha: Tensor) -> Tensor:
    """G / (4 (n.l)(n.v)) for the height-correlated Smith G [heitz2014, eq. 99]."""
    alpha_squared = alpha.square()
    rest = 1.0 - alpha_squared
    towards_view = n_dot_l * torch.sqrt(n_dot_v.square() * rest + alpha_squared)
    towards_light = n_dot_v * torch.sqrt(n_dot_l.square() * rest + alpha_squared)
    return 0.5 / (towards_view + towards_light).clamp_min(_TINY)


def schlick(specular: Tensor, l_dot_h: Tensor) -> Tensor:
    """Fresnel reflectance from F0 = specular to 1 at grazing [schlick1994, eq. 15]."""
    one_minus = (1.0 - l_dot_h).clamp(0.0, 1.0)
    squared = one_minus.square()
    return specular + (1.0 - specular) * squared.square() * one_minus


@dataclass(frozen=True)
class Angles:
    """What a specular lobe knows of directions, (..., 1, H, W) each."""

    n_dot_l: Tensor
    n_dot_v: Tensor
    """Cosines of light and view, never negative."""
    n_dot_h: Tensor
    l_dot_h: Tensor
    """Of the half vector with normal and light."""
    n_cross_h_squared: Tensor
    """The squared sine between normal and half vector."""
    least_roughness: float
    """What is smoother shows as this."""
    above: Tensor | None = None
    """Where both light and view are above the surface; None: never quite below it."""

    @staticmethod
    def exact(normal: Tensor, to_light: Tensor, to_view: Tensor) -> Angles:
        """Angles of unit vectors (..., 3, H, W), for highlights of any width; dark below."""
        # In float64: where the half vector nearly is the normal, their cross product is a
        # difference of nearly equal products, and an error of 1e-7 is a tenth of the narrowest
        # highlight.
        half = normalize(to_light.double() + to_view.double())
        n_dot_l, n_dot_v = dot(normal, to_light), dot(normal, to_view)
        n_cross_h = torch.linalg.cross(*torch.broadcast_tensors(normal.double(), half), dim=-3)
        sine_squared = dot(n_cross_h, n_cross_h).to(to_light.dtype)
        half = half.to(to_light.dtype)
        return Angles(
            n_dot_l.clamp_min(0.0),
            n_dot_v.clamp_min(0.0),
            dot(normal, half),
            dot(to_light, half),
            sine_squared,
            MIN_ROUGHNESS,
            (n_dot_l > 0) & (n_dot_v > 0),
        )

    @staticmethod
    def quick(normal: Tensor, to_light: Tensor, to_view: Tensor) -> Angles:
        """Angles in the vectors' own precision, for fits: quicker, and never quite dark.

        Lobes within 1 % of exact ones in float32 from roughness SINGLE_ROUGHNESS up; cosines below
        LEAST_COSINE count as that, so that gradients do not end at the horizon.
        """
        half = normalize(to_light + to_view)
        # Of unit vectors a chord d apart the squared sine is d^2 (1 - d^2 / 4): as exact as their
        # cross product where they nearly meet, at a fraction of its cost.
        difference = normal - half
        chord = dot(difference, difference)
        return Angles(
            dot(normal, to_light).clamp_min(LEAST_COSINE),
            dot(normal, to_view).clamp_min(LEAST_COSINE),
            dot(normal, half),
            dot(to_light, half),
            chord * (1.0 - 0.25 * chord),
            SINGLE_ROUGHNESS,
        )

    def lit(self, value: Tensor) -> Tensor:
        """A value where light and view are above the surface, 0 elsewhere."""
        return value if self.above is None else torch.where(self.above, value, 0.0)


def specular_lobe(specular: Tensor, roughness: Tensor, angles: Angles) -> Tensor:
    """D G F / (4 (n.l)(n.v)) in 1/sr, as many channels as F0 has.

    Args:
        specular: (..., 1 or 3, H, W) F0 in [0, 1].
        roughness: (..., 1, H, W) in [0, 1].
        angles: of normal, light and view, exact or quick.
    """
    alpha = roughness.clamp_min(angles.least_roughness).square()
    return angles.lit(
        ggx(angles.n_dot_h, angles.n_cross_h_squared, alpha)
        * smith_visibility(angles.n_dot_l, angles.n_dot_v, alpha)
        * schlick(specular, angles.l_dot_h)
    )


def cook_torrance(
    diffuse: Tensor,
    specular: Tensor,
    roughness: Tensor,
    normal: Tensor,
    to_light: Tensor,
    to_view: Tensor,
) -> Tensor:
    """Reflectance f in 1/sr, (..., 3, H, W); 0 where light or view is below the surface.

    Args:
        diffuse: (..., 3, H, W) diffuse albedo, linear, in [0, 1].
        specular: (..., 1, H, W) F0 in [0, 1].
        roughness: (..., 1, H, W) in [0, 1].
        normal, to_light, to_view: (..., 3, H, W) unit vectors.
    """
    angles = Angles.exact(normal, to_light, to_view)
    return angles.lit(diffuse / math.pi) + specular_lobe(specular, roughness, angles)
