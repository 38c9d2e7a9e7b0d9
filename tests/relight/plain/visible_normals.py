"""Mirrored directions of many pixels, plainly: what matcap.relight.loops is held to."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from matcap.relight.camera import Array, LatticePoint, Vec, dot, scale
from matcap.relight.texture import SurfaceSample
from plain.lobes import schlick_weight


class Mirrored(NamedTuple):
    """One direction for each pixel of a block."""

    to_light: Vec
    """Unit vectors in the material's frame."""
    weight: Array
    """G2 / G1 times the lattice's weight; 0 below the shading normal's horizon."""
    fresnel: Array
    """(1 - l.h)^5."""
    wide: Array
    """Square root of the solid angle that the direction stands for."""


@dataclass(frozen=True)
class Lobe:
    """The lobes of a block of pixels."""

    to_view: Vec
    """Unit vectors in the material's frame."""
    axes: tuple[Vec, Vec, Vec]
    """Tangents times alpha, and normal."""
    stretched: Vec
    """Unit vectors of the view in the stretched space, along these axes."""
    n_dot_v: Array
    """Cosine between normal and view, positive."""
    alpha: Array
    """GGX alpha."""

    def mirrored(self, point: LatticePoint) -> Mirrored:
        """Where the lattice's point sends the view."""
        vx, vy, vz = self.stretched
        z = (1.0 - point.u) * (1.0 + vz) - vz
        ring = np.sqrt(np.maximum(1.0 - z * z, 0.0))
        x, y = ring * point.cosine, ring * point.sine
        # The microfacet, not normalised.
        cap = (x + vx, y + vy, z + vz)
        rows = zip(*self.axes, strict=True)
        half = tuple(s * cap[0] + t * cap[1] + n * cap[2] for s, t, n in rows)
        squared = np.maximum(dot(half, half), 1e-20)
        reach = 2.0 * np.maximum(dot(self.to_view, half) / squared, 0.0)
        lx, ly, lz = (reach * h - v for h, v in zip(half, self.to_view, strict=True))
        a2 = self.alpha * self.alpha

        def smith(cosine: Array) -> Array:
            return np.sqrt(a2 + (1.0 - a2) * cosine * cosine)

        view = smith(self.n_dot_v)
        n_dot_l = reach * np.maximum(cap[2], 1e-9) - self.n_dot_v
        safe = np.maximum(n_dot_l, 1e-6)
        ratio = safe * (self.n_dot_v + view) / (safe * view + self.n_dot_v * smith(safe))
        # |cap|^2 of two unit vectors' sum; times alpha^2 / |h|^2 it is D's denominator. The
        # density of samples is G1 D / (4 n.v), G1 = 2 n.v / (n.v + view).
        spread = (2.0 + 2.0 * (x * vx + y * vy + z * vz)) / squared * a2
        solid = (self.n_dot_v + view) * (2.0 * math.pi * point.weight)
        return Mirrored(
            (lx, ly, lz),
            ratio * (n_dot_l > 0.0) * np.float32(point.weight),
            schlick_weight(reach * np.sqrt(0.25 * squared)),  # reach |h| / 2 is the cosine
            spread * np.sqrt(solid) / self.alpha,
        )


def lobe_of(sample: SurfaceSample, to_view: Vec, n_dot_v: Array) -> Lobe:
    """The lobes of a block.

    Args:
        sample: the material; only normal and alpha matter.
        to_view: unit vectors in the material's frame.
        n_dot_v: their cosines with the normal; lobes without a positive one mean nothing.
    """
    across, along = (scale(one, sample.alpha) for one in basis(sample.normal))
    n_dot_v = np.maximum(n_dot_v, np.float32(1e-4))
    vx, vy = dot(to_view, across), dot(to_view, along)
    inverse = 1.0 / np.sqrt(vx * vx + vy * vy + n_dot_v * n_dot_v)
    stretched = scale((vx, vy, n_dot_v), inverse)
    return Lobe(to_view, (across, along, sample.normal), stretched, n_dot_v, sample.alpha)


def basis(normal: Vec) -> tuple[Vec, Vec]:
    """Two unit vectors that complete unit normals (Duff et al. 2017)."""
    x, y, z = normal
    sign = np.copysign(np.float32(1.0), z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)
