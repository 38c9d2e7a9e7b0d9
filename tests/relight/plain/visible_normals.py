"""Mirrored directions of many pixels, plainly: what matcap.relight.loops is held to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcap.relight.sampling import SurfaceSample
from matcap.relight.vectors import Array, Vec, dot, scale
from matcap.relight.visible_normals import LatticePoint
from plain.lobes import schlick_weight


@dataclass(frozen=True)
class Lobe:
    """The lobes of a block of pixels, or of some of them.

    Attributes:
        normal, to_view: unit vectors in the material's frame.
        across, along: tangents times alpha.
        middle: of the cap, in the frame: the stretched view's microfacet.
        stretched: unit vector of the view in the stretched space.
        n_dot_v: positive.
        alpha: GGX alpha.
    """

    normal: Vec
    to_view: Vec
    across: Vec
    along: Vec
    middle: Vec
    stretched: Vec
    n_dot_v: Array
    alpha: Array

    def mirrored(self, point: LatticePoint) -> Mirrored:
        """Where the lattice's point sends the view."""
        vx, vy, vz = self.stretched
        z = np.float32(1.0 - point.u) * (1.0 + vz) - vz
        ring = np.sqrt(np.maximum(1.0 - z * z, np.float32(0.0)))
        a, b = ring * np.float32(point.cosine), ring * np.float32(point.sine)
        rows = zip(self.middle, self.across, self.along, self.normal, strict=True)
        hx, hy, hz = (m + s * a + t * b + n * z for m, s, t, n in rows)
        half = (hx, hy, hz)
        squared = np.maximum(dot(half, half), np.float32(1e-20))
        return Mirrored(self, point, (a, b, z), half, 1.0 / squared)

    @cached_property
    def view_term(self) -> Array:
        """Smith's term of the view times n.v (1 + Lambda) 2 - n.v."""
        squared = self.alpha * self.alpha
        return np.sqrt(squared + (1.0 - squared) * self.n_dot_v * self.n_dot_v)

    @cached_property
    def size(self) -> Array:
        """Square root of the solid angle that the whole lattice divides, where h is the normal."""
        # density = G1 D / (4 n.v) with G1 = 2 n.v / (n.v + view_term), D = (alpha / spread)^2 / pi.
        return np.sqrt((self.n_dot_v + self.view_term) * np.float32(2.0 * math.pi)) / self.alpha


@dataclass(frozen=True)
class Mirrored:
    """One direction for each pixel of a block; what it is good for is worked out when asked.

    Attributes:
        lobe: of the pixels.
        point: of the lattice.
        cap: the point in the stretched space.
        half: the microfacet, not normalised.
        inverse: 1 / |half|^2.
    """

    lobe: Lobe
    point: LatticePoint
    cap: Vec
    half: Vec
    inverse: Array

    @cached_property
    def reach(self) -> Array:
        """2 v.h / |h|^2, v and h as they are."""
        return np.maximum(dot(self.lobe.to_view, self.half) * self.inverse, 0.0) * np.float32(2.0)

    @cached_property
    def rise(self) -> Array:
        """The direction's component along the frame's normal."""
        return self.reach * self.half[2] - self.lobe.to_view[2]

    @cached_property
    def to_light(self) -> Vec:
        """Unit vectors in the material's frame."""
        x, y = (self.reach * self.half[i] - self.lobe.to_view[i] for i in range(2))
        return x, y, self.rise

    @cached_property
    def wide(self) -> Array:
        """Square root of the solid angle that the direction stands for."""
        vx, vy, vz = self.lobe.stretched
        a, b, z = self.cap
        # |cap + view|^2 of two unit vectors; times alpha^2 / |h|^2 it is D's denominator.
        apart = 2.0 + 2.0 * (a * vx + b * vy + z * vz)
        alpha = self.lobe.alpha
        spread = apart * self.inverse * (alpha * alpha)
        return spread * self.lobe.size * np.float32(math.sqrt(self.point.weight))

    @cached_property
    def n_dot_l(self) -> Array:
        """Cosine between the shading normal and the direction, of either sign."""
        tilt = np.maximum(self.cap[2] + self.lobe.stretched[2], np.float32(1e-9))
        return self.reach * tilt - self.lobe.n_dot_v

    @property
    def above(self) -> Array:
        """Whether the direction is above the undisplaced surface."""
        clear: Array = self.rise > 0.0
        return clear

    @property
    def weight(self) -> Array:
        """G2 / G1 times the lattice's weight; 0 below the shading normal's horizon."""
        lobe = self.lobe
        n_dot_l = np.maximum(self.n_dot_l, np.float32(1e-6))
        squared = lobe.alpha * lobe.alpha
        light_term = np.sqrt(squared + (1.0 - squared) * n_dot_l * n_dot_l)
        ratio = n_dot_l * (lobe.n_dot_v + lobe.view_term)
        ratio /= n_dot_l * lobe.view_term + lobe.n_dot_v * light_term
        return ratio * ((self.n_dot_l > 0.0) * np.float32(self.point.weight))

    @property
    def fresnel(self) -> Array:
        """(1 - l.h)^5."""
        # reach |h| / 2 is the cosine.
        return schlick_weight(self.reach * np.sqrt(np.float32(0.25) / self.inverse))


def lobe_of(sample: SurfaceSample, to_view: Vec, n_dot_v: Array) -> Lobe:
    """The lobes of a block.

    Args:
        sample: the material; only normal and alpha matter.
        to_view: unit vectors in the material's frame.
        n_dot_v: their cosines with the normal; lobes without a positive one mean nothing.
    """
    normal, alpha = sample.normal, sample.alpha
    tangent, bitangent = basis(normal)
    n_dot_v = np.maximum(n_dot_v, np.float32(1e-4))
    across, along = scale(tangent, alpha), scale(bitangent, alpha)
    vx, vy = dot(to_view, across), dot(to_view, along)
    inverse = 1.0 / np.sqrt(vx * vx + vy * vy + n_dot_v * n_dot_v)
    vx, vy, vz = vx * inverse, vy * inverse, n_dot_v * inverse
    rows = zip(across, along, normal, strict=True)
    mx, my, mz = (s * vx + t * vy + n * vz for s, t, n in rows)
    return Lobe(normal, to_view, across, along, (mx, my, mz), (vx, vy, vz), n_dot_v, alpha)


def basis(normal: Vec) -> tuple[Vec, Vec]:
    """Two unit vectors that complete unit normals (Duff et al. 2017)."""
    x, y, z = normal
    sign = np.copysign(np.float32(1.0), z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)
