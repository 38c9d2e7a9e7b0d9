"""Directional albedo of the specular lobe, tabulated once a process.

E(mu, alpha) is the directional albedo of D G / (4 (n.l)(n.v)) with F = 1, and split in two for
Schlick's Fresnel: albedo = F0 scale + bias (Karis 2013). Integrated over the lattice of visible
normals, where the integrand is G2 / G1; values are within 2e-4 of exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from matcap.relight.vectors import Array
from matcap.relight.visible_normals import LatticePoint, lattice

_SIZE = 64
_POINTS = 987
_FINE = 1024
# Places where the energy that is lost is tabulated, for the nearest to be taken.
_ALPHAS, _COSINES = 512, 1024


@dataclass(frozen=True)
class Albedo:
    """Tables over x = sqrt(mu) (columns) and sqrt(alpha), the roughness (rows), both in [0, 1]."""

    bias: Array
    """The part that goes with (1 - l.h)^5."""
    total: Array
    """With F = 1; scale = total - bias."""
    average: Array
    """(rows,) cosine-weighted mean of total over the hemisphere."""

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
        value = np.take(fine, (rows + j).astype(np.intp), mode="clip")
        values: Array = value.real + (x - j) * value.imag
        return values

    @cached_property
    def fine_total(self) -> Array:
        """Total at 1024 roughnesses: complex, the value and its step to the next."""
        return _fine(self.total)

    @cached_property
    def fine_bias(self) -> Array:
        """Bias likewise."""
        return _fine(self.bias)

    def near(self, alpha: Array) -> Array:
        """Where missing() begins for alphas: the nearest of 512, whole numbers as float32."""
        return np.rint(alpha * np.float32(_ALPHAS - 1)) * np.float32(_COSINES)

    def missing(self, near: Array, mu: Array) -> Array:
        """1 - total at cosines, the nearest of those tabulated: within 1e-3, and quick."""
        index = mu * np.float32(_COSINES - 1) + (near + np.float32(0.5))
        return np.take(self.lost, index.astype(np.intp), mode="clip")

    @property
    def lost_step(self) -> float:
        """How much further in `lost` the cosine 1 is than 0."""
        return _COSINES - 1.0

    def average_at(self, near: Array) -> Array:
        """The average for alphas."""
        return np.take(self._averages, (near * np.float32(1.0 / _COSINES)).astype(np.intp))

    @cached_property
    def lost(self) -> Array:
        """What missing() looks up: a row for each of 512 alphas, over cosines."""
        roughness = np.sqrt(np.linspace(0.0, 1.0, _ALPHAS))
        root_mu = np.sqrt(np.linspace(0.0, 1.0, _COSINES))
        total = _between(_between(self.total, roughness).T, root_mu).T
        return np.ascontiguousarray(np.maximum(1.0 - total, 0.0)).ravel()

    @cached_property
    def _averages(self) -> Array:
        return _between(self.average[:, None], np.sqrt(np.linspace(0.0, 1.0, _ALPHAS)))[:, 0]


def _between(table: Array, places: Array) -> Array:
    """The rows of a table, and straight lines between them, at places in [0, 1]."""
    y = places * (_SIZE - 1.0)
    i = np.minimum(y.astype(np.intp), _SIZE - 2)
    share = (y - i)[:, None]
    rows: Array = (table[i] * (1.0 - share) + table[i + 1] * share).astype(np.float32)
    return rows


def _fine(table: Array) -> Array:
    rows = _between(table, np.linspace(0.0, 1.0, _FINE))
    steps = np.diff(rows, axis=1, append=rows[:, -1:])
    return np.ascontiguousarray(rows + 1j * steps, dtype=np.complex64).ravel()


@lru_cache(maxsize=1)
def albedo() -> Albedo:
    """The tables."""
    root_mu = np.linspace(0.0, 1.0, _SIZE)
    mu = np.maximum(root_mu**2, 1e-6)[None, :]
    alpha = np.maximum(np.linspace(0.0, 1.0, _SIZE) ** 2, 1e-6)[:, None]
    total, bias = np.zeros((2, _SIZE, _SIZE))
    for point in lattice(_POINTS):
        weight, cosine = _visible(mu, alpha, point)
        total += weight
        bias += weight * np.clip(1.0 - cosine, 0.0, 1.0) ** 5
    # 2 E mu dmu with mu = x^2 is 4 E x^3 dx.
    fine = np.linspace(0.0, 1.0, 2001)
    integrand = np.stack([np.interp(fine, root_mu, row) for row in total]) * 4.0 * fine**3
    average = np.trapezoid(integrand, fine, axis=1)
    f = np.float32
    return Albedo(bias.astype(f), total.astype(f), np.asarray(average, dtype=f))


def _visible(mu: Array, alpha: Array, point: LatticePoint) -> tuple[Array, Array]:
    """G2 / G1 times the weight, and the cosine v.h, of one visible normal."""
    sine = np.sqrt(np.maximum(1.0 - mu * mu, 0.0))
    vx, vz = alpha * sine, mu
    length = np.sqrt(vx * vx + vz * vz)
    vx, vz = vx / length, vz / length
    z = (1.0 - point.u) * (1.0 + vz) - vz
    ring = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    hx, hy = alpha * (ring * point.cosine + vx), alpha * (ring * point.sine)
    hz = np.maximum(z + vz, 1e-12)
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
    return np.where(n_dot_l > 0.0, ratio, 0.0) * point.weight, cosine
