"""How much the specular lobe reflects altogether, tabulated once a process.

E(mu, alpha) is the directional albedo of D G / (4 (n.l)(n.v)) with F = 1, and split in two for
Schlick's Fresnel: albedo = F0 scale + bias (Karis 2013). Integrated by a Gauss-Legendre product
rule over the visible normals (Heitz 2018), where the integrand is G2 / G1, which is smooth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from matcap.relight.vectors import Array

_SIZE = 40
_ORDER = 24
_FINE = 1024


@dataclass(frozen=True)
class Albedo:
    """Tables over x = sqrt(mu) (columns) and sqrt(alpha), the roughness (rows), both in [0, 1].

    Attributes:
        bias: the part that goes with (1 - l.h)^5.
        total: with F = 1; scale = total - bias.
        average: (rows,) cosine-weighted mean of total over the hemisphere.
    """

    bias: Array
    total: Array
    average: Array

    def rows(self, alpha: Array) -> Array:
        """Where the lookups below begin for alphas: the nearest of 1024 roughnesses.

        Whole numbers kept as float32, which holds them exactly and adds fastest.
        """
        rough = np.sqrt(np.asarray(alpha, dtype=np.float32))
        return np.rint(rough * np.float32(_FINE - 1)) * np.float32(_SIZE)

    def lookup(self, fine: Array, mu: Array, rows: Array) -> Array:
        """Values of fine_total or fine_bias at cosines, linear between those tabulated."""
        x = np.sqrt(np.asarray(mu, dtype=np.float32)) * np.float32(_SIZE - 1)
        j = np.floor(x)
        found = np.take(fine, (rows + j).astype(np.intp), mode="clip")
        values: Array = found.real + (x - j) * found.imag
        return values

    @cached_property
    def fine_total(self) -> Array:
        """Total at 1024 roughnesses, each value beside its step to the next, as real and imag."""
        return _fine(self.total)

    @cached_property
    def fine_bias(self) -> Array:
        """Bias likewise."""
        return _fine(self.bias)

    def mean(self, rows: Array) -> Array:
        """The average of rows()."""
        return np.take(self._fine_average, np.rint(rows * np.float32(1.0 / _SIZE)).astype(np.intp))

    @cached_property
    def _fine_average(self) -> Array:
        return _between(self.average[:, None])[:, 0]


def _between(table: Array) -> Array:
    """The rows of a table, and straight lines between them, at 1024 roughnesses."""
    y = np.linspace(0.0, _SIZE - 1.0, _FINE)
    i = np.minimum(y.astype(np.intp), _SIZE - 2)
    share = (y - i)[:, None]
    rows: Array = (table[i] * (1.0 - share) + table[i + 1] * share).astype(np.float32)
    return rows


def _fine(table: Array) -> Array:
    rows = _between(table)
    steps = np.diff(rows, axis=1, append=rows[:, -1:])
    return np.ascontiguousarray(rows + 1j * steps, dtype=np.complex64).ravel()


@lru_cache(maxsize=1)
def albedo() -> Albedo:
    """The tables."""
    root_mu = np.linspace(0.0, 1.0, _SIZE)
    mu = np.maximum(root_mu**2, 1e-6)[None, :, None]
    alpha = np.maximum(np.linspace(0.0, 1.0, _SIZE) ** 2, 1e-6)[:, None, None]
    weight, cosine, weights = visible_rule(mu, alpha)
    total = (weight * weights).sum(axis=-1)
    rest = np.clip(1.0 - cosine, 0.0, 1.0)
    bias = (weight * rest**5 * weights).sum(axis=-1)
    # 2 E mu dmu with mu = x^2 is 4 E x^3 dx.
    fine = np.linspace(0.0, 1.0, 2001)
    integrand = np.stack([np.interp(fine, root_mu, row) for row in total]) * 4.0 * fine**3
    average = np.trapezoid(integrand, fine, axis=1)
    f = np.float32
    return Albedo(bias.astype(f), total.astype(f), np.asarray(average, dtype=f))


def visible_rule(mu: Array, alpha: Array) -> tuple[Array, Array, Array]:
    """G2 / G1, the cosine v.h and the weights of a rule over visible normals, on the last axis."""
    nodes, gauss = np.polynomial.legendre.leggauss(_ORDER)
    u, v = (nodes + 1.0) / 2.0, (nodes + 1.0) / 2.0
    weights = (gauss[:, None] * gauss[None, :]).ravel() / 4.0
    # Half the disc is enough: the other half is its mirror image.
    radius = np.repeat(np.sqrt(u), _ORDER)
    angle = np.tile(v, _ORDER) * math.pi
    sine = np.sqrt(np.maximum(1.0 - mu * mu, 0.0))
    vx, vz = alpha * sine, mu
    length = np.sqrt(vx * vx + vz * vz)
    vx, vz = vx / length, vz / length
    t1 = radius * np.sin(angle)  # along y, of either sign
    t2 = radius * np.cos(angle)
    blend = 0.5 * (1.0 + vz)
    t2 = (1.0 - blend) * np.sqrt(np.maximum(1.0 - t1 * t1, 0.0)) + blend * t2
    t3 = np.sqrt(np.maximum(1.0 - t1 * t1 - t2 * t2, 0.0))
    # Basis of the stretched view (vx, 0, vz): T1 = y, T2 = v x T1 = (-vz, 0, vx).
    hx, hy, hz = t3 * vx - t2 * vz, t1, t3 * vz + t2 * vx
    hx, hy, hz = alpha * hx, alpha * hy, np.maximum(hz, 0.0)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hz = hx / length, hz / length
    cosine = sine * hx + mu * hz
    n_dot_l = 2.0 * cosine * hz - mu
    a2 = alpha * alpha
    towards_view = np.sqrt(a2 + (1.0 - a2) * mu * mu)
    safe = np.maximum(n_dot_l, 1e-12)
    towards_light = np.sqrt(a2 + (1.0 - a2) * safe * safe)
    # G2 = 2 nl nv / (nl Av + nv Al), G1 = 2 nv / (nv + Av).
    ratio = safe * (mu + towards_view) / (safe * towards_view + mu * towards_light)
    return np.where(n_dot_l > 0.0, ratio, 0.0), cosine, weights
