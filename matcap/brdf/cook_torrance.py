"""The Cook-Torrance microfacet BRDF [cook1982] of all of matcap, its parameters, F0 of metals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import NamedTuple

import torch
from torch import Tensor

from matcap.brdf.maps import CHANNELS, MapSet, split_stacked

# f = diffuse / pi + D G F / (4 (n.l)(n.v)): D is GGX [walter2007, eq. 33], G height-correlated
# Smith [heitz2014, eq. 99], F Schlick's Fresnel [schlick1994, eq. 15]; alpha = roughness^2. No
# multiple scattering between microfacets (relight adds it).
#
# Stable in float32:
#
# - D's denominator 1 - (n.h)^2 (1 - alpha^2) cancels near n.h = 1 for small alpha; it is computed
#   as |n x h|^2 + (n.h)^2 alpha^2.
# - G / (4 (n.l)(n.v)) is one term [heitz2014], which divides by no grazing cosine.

# Roughness is clamped to this: alpha = 1e-6, whose square and whose peak D = 1 / (pi alpha^2) are
# well inside float32, and which no picture can distinguish from 0.
MIN_ROUGHNESS = 1e-3
SINGLE_ROUGHNESS = 0.05  # the same for Angles.quick, whose rounding is 1e-3 of alpha there
LEAST_COSINE = 1e-3  # smallest cosine of Angles.quick

# Smallest denominator of the visibility term: reached where both cosines are grazing.
_TINY = 1e-7

# Smallest denominator of D, below alpha^2 at MIN_ROUGHNESS: reached only where light and view are
# opposed and there is no half vector.
_LEAST_SPREAD = 1e-14


def dot(a: Tensor, b: Tensor) -> Tensor:
    """(..., 1, H, W) scalar product of (..., 3, H, W) vectors."""
    return (a * b).sum(dim=-3, keepdim=True)


def _cross_squared(a: Tensor, b: Tensor) -> Tensor:
    """(..., 1, H, W) squared length of the vector product of (..., 3, H, W) vectors."""
    # Written out: a third of torch.linalg.cross's time.
    (ax, ay, az), (bx, by, bz) = a.split(1, dim=-3), b.split(1, dim=-3)
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return x * x + y * y + z * z


def normalize(vector: Tensor) -> Tensor:
    """(..., 3, H, W) unit vectors; a zero vector stays zero, with gradient zero."""
    squared = dot(vector, vector)
    safe = torch.where(squared > 0, squared, torch.ones_like(squared))
    return vector * torch.where(squared > 0, torch.rsqrt(safe), torch.zeros_like(squared))


def ggx(n_dot_h: Tensor, n_cross_h_squared: Tensor, alpha: Tensor) -> Tensor:
    """GGX distribution of normals D [walter2007, eq. 33], in 1/sr.

    Args:
        n_dot_h: cosine between normal and half vector.
        n_cross_h_squared: its squared sine, computed without cancellation.
        alpha: roughness^2, positive.
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
    return specular + (1.0 - specular) * one_minus.square().square() * one_minus


@dataclass(frozen=True)
class Angles:
    """Cosines between normal n, light l, view v and half vector h, (..., 1, H, W) each."""

    n_dot_l: Tensor
    n_dot_v: Tensor
    """Clamped to 0, or in quick() to LEAST_COSINE."""
    n_dot_h: Tensor
    l_dot_h: Tensor
    n_cross_h_squared: Tensor
    """|n x h|^2, the squared sine."""
    least_roughness: float
    """Roughness is clamped to this."""
    above: Tensor | None = None
    """bool, light and view are above the surface; None in quick(), which ignores the horizon."""

    @staticmethod
    def exact(normal: Tensor, to_light: Tensor, to_view: Tensor) -> Angles:
        """Angles of unit vectors (..., 3, H, W), in float64: for highlights of any width."""
        # float64: where h is nearly n, the cross product is a difference of nearly equal products,
        # and an error of 1e-7 is a tenth of the narrowest highlight.
        half = normalize(to_light.double() + to_view.double())
        n_dot_l, n_dot_v = dot(normal, to_light), dot(normal, to_view)
        sine_squared = _cross_squared(normal.double(), half).to(to_light.dtype)
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
    def quick(normal: Tensor, to_light: Tensor, to_view: Tensor, half: Tensor) -> Angles:
        """Angles of unit vectors (..., 3, H, W), in the vectors' own precision: for fits.

        In float32 lobes are within 1 % of exact() from roughness SINGLE_ROUGHNESS up. Cosines are
        clamped to LEAST_COSINE, so that gradients do not vanish at the horizon. `half` is between
        `to_light` and `to_view`.
        """
        # |n x h|^2 = d^2 (1 - d^2 / 4) with the chord d = |n - h|: as accurate as the cross product
        # where they nearly coincide, at a fraction of its cost.
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
        """`value` where light and view are above the surface, 0 elsewhere."""
        return value if self.above is None else torch.where(self.above, value, 0.0)


def specular_lobe(specular: Tensor, roughness: Tensor, angles: Angles) -> Tensor:
    """D G F / (4 (n.l)(n.v)) in 1/sr, with the channels of F0.

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


class LobeGradient(NamedTuple):
    """Derivatives of log specular_lobe, (..., 1, H, W) each."""

    log_specular: Tensor
    logit_roughness: Tensor
    n_dot_l: Tensor
    n_dot_v: Tensor
    n_dot_h: Tensor

    @staticmethod
    def of(specular: Tensor, roughness: Tensor, angles: Angles) -> LobeGradient:
        """At F0 and roughness of one channel (..., 1, H, W)."""
        light, view, half = angles.n_dot_l, angles.n_dot_v, angles.n_dot_h
        alpha_squared = roughness.clamp_min(angles.least_roughness).square().square()
        rest, squared = 1.0 - alpha_squared, half.square()
        spread = (angles.n_cross_h_squared + squared * alpha_squared).clamp_min(_LEAST_SPREAD)
        view_squared, light_squared = view.square(), light.square()
        to_view = torch.sqrt(view_squared * rest + alpha_squared)
        to_light = torch.sqrt(light_squared * rest + alpha_squared)
        masked = -1.0 / (light * to_view + view * to_light).clamp_min(_TINY)  # d log V / d (sum)
        across = light * view * rest
        rougher = light * (1.0 - view_squared) / to_view + view * (1.0 - light_squared) / to_light
        by_log_alpha = 2.0 - alpha_squared * (4.0 * squared / spread - masked * rougher)
        free = (roughness > angles.least_roughness) * (2.0 - 2.0 * roughness)
        grazing = schlick(torch.zeros_like(specular), angles.l_dot_h)
        return LobeGradient(
            specular * (1.0 - grazing) / (specular + (1.0 - specular) * grazing),
            by_log_alpha * free,
            masked * (to_view + across / to_light),
            masked * (to_light + across / to_view),
            4.0 * half * rest / spread,
        )


def cook_torrance(
    diffuse: Tensor,
    specular: Tensor,
    roughness: Tensor,
    normal: Tensor,
    to_light: Tensor,
    to_view: Tensor,
) -> Tensor:
    """BRDF f in 1/sr, (..., 3, H, W); 0 where light or view is below the surface.

    Args:
        diffuse: (..., 3, H, W) diffuse albedo, linear, in [0, 1].
        specular: (..., 1, H, W) F0 in [0, 1].
        roughness: (..., 1, H, W) in [0, 1].
        normal, to_light, to_view: (..., 3, H, W) unit vectors.
    """
    angles = Angles.exact(normal, to_light, to_view)
    return angles.lit(diffuse / math.pi) + specular_lobe(specular, roughness, angles)


# F0 of clean metals at normal incidence, linear Rec.709.
#
# From measured refractive indices [lagarde2011]; [akenine2018, table 9.2] agrees within a few
# hundredths. Brass is an alloy, of which tables differ by as much. Steel is iron.

METAL_F0: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "gold": (1.000, 0.766, 0.336),
        "copper": (0.955, 0.638, 0.538),
        "brass": (0.887, 0.789, 0.434),
        "aluminium": (0.913, 0.922, 0.924),
        "steel": (0.56, 0.57, 0.58),
    }
)


# Unconstrained parameters of a surface, for networks and optimisers.
#
# log diffuse albedo, log F0, logit roughness, height in texels; with the limits that reflectance is
# clamped to. Stacked channels are ordered as in MapSet.stacked.

# Of a parameter vector of one surface or texel: log albedo (3), log F0, logit roughness.
ALBEDO, F0, ROUGH = slice(0, 3), 3, 4
REFLECTANCE = {name: count for name, count in CHANNELS.items() if name != "height"}

ALBEDO_LIMITS = (0.001, 0.99)  # of a diffuse channel
F0_LIMITS = (0.005, 0.99)
ROUGHNESS_LIMITS = (0.001, 0.999)
_ROUGHNESS_LOGITS = 7.0  # largest |logit|: slightly beyond ROUGHNESS_LIMITS, which thus round-trip


class Reflectance(NamedTuple):
    """Reflectance maps, a MapSet's without the height."""

    diffuse: Tensor
    """(..., 3, H, W) diffuse albedo."""
    specular: Tensor
    """(..., 1, H, W) F0; 3 channels if coloured."""
    roughness: Tensor
    """(..., 1, H, W) perceptual roughness."""


@dataclass(frozen=True)
class SurfaceParameters:
    """Parameters of a surface, or differences of two surfaces' parameters.

    Shapes need only broadcast with each other.
    """

    diffuse: Tensor
    """(..., 3, H, W) log of diffuse albedo."""
    specular: Tensor
    """(..., 1, H, W) log of F0; 3 channels if coloured."""
    roughness: Tensor
    """(..., 1, H, W) logit of perceptual roughness."""
    height: Tensor
    """(..., 1, H, W) in texels."""

    @staticmethod
    def of(maps: MapSet) -> SurfaceParameters:
        """Parameters of maps, whose reflectance is clamped to the limits."""
        return SurfaceParameters(
            maps.diffuse.clamp(*ALBEDO_LIMITS).log(),
            maps.specular.clamp(*F0_LIMITS).log(),
            maps.roughness.clamp(*ROUGHNESS_LIMITS).logit(),
            maps.height / maps.texel_size,
        )

    @staticmethod
    def uniform(
        diffuse: tuple[float, float, float], specular: float, roughness: float
    ) -> SurfaceParameters:
        """Parameters of a flat, uniform surface, (..., 1, 1) each; only roughness is clamped."""
        gloss = torch.tensor([specular, roughness], dtype=torch.float64)[:, None, None, None]
        return SurfaceParameters(
            torch.tensor(diffuse).log()[:, None, None],
            gloss[0].log().float(),
            gloss[1].clamp(*ROUGHNESS_LIMITS).logit().float(),
            torch.zeros(1, 1, 1),
        )

    def reflectance(self) -> Reflectance:
        """The reflectance, clamped to the limits."""
        return Reflectance(
            self.diffuse.exp().clamp(*ALBEDO_LIMITS),
            self.specular.exp().clamp(*F0_LIMITS),
            torch.sigmoid(self.roughness.clamp(-_ROUGHNESS_LOGITS, _ROUGHNESS_LOGITS)),
        )

    def maps(self, texel_size: float) -> MapSet:
        """Maps, clamped to the limits; texel_size in plane units."""
        return MapSet(*self.reflectance(), self.height * texel_size, texel_size)

    def map(self, change: Callable[[Tensor], Tensor]) -> SurfaceParameters:
        """The parameters with `change` applied to each."""
        return SurfaceParameters(*(change(getattr(self, f.name)) for f in fields(self)))

    def __add__(self, other: SurfaceParameters) -> SurfaceParameters:
        return SurfaceParameters(
            *(getattr(self, f.name) + getattr(other, f.name) for f in fields(self))
        )

    def __sub__(self, other: SurfaceParameters) -> SurfaceParameters:
        return SurfaceParameters(
            *(getattr(self, f.name) - getattr(other, f.name) for f in fields(self))
        )

    def to(self, like: Tensor) -> SurfaceParameters:
        """Converted to a tensor's device and dtype."""
        return self.map(lambda values: values.to(like))

    def vector(self) -> Tensor:
        """(5,) ALBEDO, F0 and ROUGH of a flat, uniform surface."""
        return torch.cat([self.diffuse, self.specular, self.roughness]).flatten()

    @staticmethod
    def from_vector(vector: Tensor) -> SurfaceParameters:
        """A flat, uniform surface with these parameters (5,), the inverse of vector()."""
        diffuse, specular, roughness = vector[:, None, None].split(list(REFLECTANCE.values()))
        return SurfaceParameters(diffuse, specular, roughness, torch.zeros_like(specular))

    def stacked(self) -> Tensor:
        """(..., 6 or 8, H, W), channels as in MapSet.stacked."""
        return torch.cat([self.diffuse, self.specular, self.roughness, self.height], dim=-3)

    @staticmethod
    def from_stacked(stacked: Tensor) -> SurfaceParameters:
        """The inverse of stacked()."""
        return SurfaceParameters(*split_stacked(stacked))
