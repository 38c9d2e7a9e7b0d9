"""Multiple scattering between microfacets: the energy that a single bounce loses [kulla2017].

f_ms = Fms (1 - E(n.l)) (1 - E(n.v)) / (pi (1 - Eavg)), Fms = Favg^2 Eavg / (1 - Favg (1 - Eavg)),
Favg = F0 + (1 - F0) / 21 for Schlick's Fresnel; E and Eavg are tables of the lobe's directional
albedo. Reciprocal; with F0 = 1 all energy is reflected.

Left out: rough metals lose up to half their light. Cost: two table lookups a light and pixel.
Captures are fitted without it (brdf/cook_torrance.py): with the F0 of dielectrics, 0.04, it is too
small to see.
"""

from __future__ import annotations

import math
from ctypes import byref, c_int64
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from matcap.relight.camera import Array
from matcap.relight.effects import Bound
from matcap.relight.loops.library import CHorizon, CPixels, KeptArrays, address, directions, loops
from matcap.relight.plan import SceneBounds

# Tables of the specular lobe's directional albedo, computed once a process.
#
# E(mu, alpha) is the albedo of D G / (4 (n.l)(n.v)), F = 1, at mu = n.v. With Schlick's Fresnel it
# is F0 scale + bias [karis2013]. Integrated over the lattice of visible normals, where the
# integrand is G2 / G1; errors are below 2e-4.

_SIZE = 64
_POINTS = 987
_FINE = 1024
# Grid of `lost`, for lookups of the nearest entry.
_ALPHAS, _COSINES = 512, 1024


@dataclass(frozen=True)
class Albedo:
    """Albedo tables: rows by perceptual roughness sqrt(alpha), columns by sqrt(mu), in [0, 1]."""

    bias: Array
    """(64, 64) integral weighted by Schlick's (1 - l.h)^5."""
    total: Array
    """(64, 64) E; scale = total - bias."""
    average: Array
    """(64,) cosine-weighted mean of `total` over the hemisphere, Eavg."""

    def rows(self, alpha: Array) -> Array:
        """Index of the first entry of an alpha's row in fine_total and fine_bias.

        The nearest of 1024 roughnesses; integers as float32, exact, for fast sums with mu.
        """
        rough = np.sqrt(np.asarray(alpha, dtype=np.float32))
        return np.rint(rough * np.float32(_FINE - 1)) * np.float32(_SIZE)

    def lookup(self, fine: Array, mu: Array, rows: Array) -> Array:
        """Values of fine_total or fine_bias at mu, linear in sqrt(mu); rows: of rows()."""
        x = np.sqrt(np.asarray(mu, dtype=np.float32)) * np.float32(_SIZE - 1)
        j = np.floor(x)
        value = np.take(fine, (rows + j).astype(np.intp), mode="clip")
        return value.real + (x - j) * value.imag

    @cached_property
    def fine_total(self) -> Array:
        """`total` interpolated to 1024 roughnesses, flattened by rows, as complex numbers.

        Real part: the value; imaginary part: the next value along mu minus it, so that a linear
        interpolation reads one number.
        """
        return _fine(self.total)

    @cached_property
    def fine_bias(self) -> Array:
        """`bias` in the layout of fine_total."""
        return _fine(self.bias)

    def near(self, alpha: Array) -> Array:
        """Index in `lost` of (nearest tabulated alpha, mu = 0); an integer, as float32."""
        return np.rint(alpha * np.float32(_ALPHAS - 1)) * np.float32(_COSINES)

    def missing(self, near: Array, mu: Array) -> Array:
        """1 - E(mu), the energy a single bounce loses: nearest entry of `lost`, within 1e-3."""
        index = mu * np.float32(_COSINES - 1) + (near + np.float32(0.5))
        return np.take(self.lost, index.astype(np.intp), mode="clip")

    @property
    def lost_step(self) -> float:
        """Offset in `lost` from mu = 0 to mu = 1."""
        return _COSINES - 1.0

    def average_at(self, near: Array) -> Array:
        """Eavg; near: of near()."""
        return np.take(self._averages, (near * np.float32(1.0 / _COSINES)).astype(np.intp))

    @cached_property
    def lost(self) -> Array:
        """1 - E, flat: 512 rows by alpha, 1024 columns by mu, both uniform in [0, 1]."""
        roughness = np.sqrt(np.linspace(0.0, 1.0, _ALPHAS))
        root_mu = np.sqrt(np.linspace(0.0, 1.0, _COSINES))
        total = _between(_between(self.total, roughness).T, root_mu).T
        return np.ascontiguousarray(np.maximum(1.0 - total, 0.0)).ravel()

    @cached_property
    def _averages(self) -> Array:
        return _between(self.average[:, None], np.sqrt(np.linspace(0.0, 1.0, _ALPHAS)))[:, 0]


def _between(table: Array, places: Array) -> Array:
    """A table's rows, uniform in [0, 1], linearly interpolated at (n,) places: (n, columns)."""
    y = places * (_SIZE - 1.0)
    i = np.minimum(y.astype(np.intp), _SIZE - 2)
    share = (y - i)[:, None]
    return (table[i] * (1.0 - share) + table[i + 1] * share).astype(np.float32)


def _fine(table: Array) -> Array:
    rows = _between(table, np.linspace(0.0, 1.0, _FINE))
    steps = np.diff(rows, axis=1, append=rows[:, -1:])
    return np.ascontiguousarray(rows + 1j * steps, dtype=np.complex64).ravel()


@lru_cache(maxsize=1)
def albedo() -> Albedo:
    """Compute the tables."""
    root_mu = np.linspace(0.0, 1.0, _SIZE)
    mu = np.maximum(root_mu**2, 1e-4)[None, :]  # the loops' least n.v
    alpha = np.maximum(np.linspace(0.0, 1.0, _SIZE) ** 2, 1e-6)[:, None]
    total, bias = (one.reshape(_SIZE, _SIZE) for one in _lobe_albedo(mu, alpha))
    # Eavg = integral of 2 E mu dmu; with mu = x^2 that is 4 E x^3 dx.
    fine = np.linspace(0.0, 1.0, 2001)
    integrand = np.stack([np.interp(fine, root_mu, row) for row in total]) * 4.0 * fine**3
    average = np.trapezoid(integrand, fine, axis=1)
    f = np.float32
    return Albedo(bias.astype(f), total.astype(f), np.asarray(average, dtype=f))


def _lobe_albedo(mu: Array, alpha: Array) -> tuple[Array, Array]:
    """E and its part weighted by Schlick's (1 - l.h)^5: what a surface facing downwards hides.

    Under uniform radiance the ground hides all of the lobe of a normal along -z.
    """
    kept, count = KeptArrays(), mu.size * alpha.size
    mu, alpha = (np.broadcast_to(one, (alpha.size, mu.size)).ravel() for one in (mu, alpha))
    zero, which = np.zeros(count), np.arange(count, dtype=np.int32)
    hidden = np.empty((2, count), dtype=np.float32)
    pixels = CPixels(
        count=count,
        view=(kept.of(np.sqrt(1.0 - mu * mu)), kept.of(zero), kept.of(-mu)),
        normal=(kept.of(zero), kept.of(zero), kept.of(zero - 1.0)),
        n_dot_v=kept.of(mu),
        alpha=kept.of(alpha),
    )
    loops().matcap_relight_hidden(
        byref(pixels), byref(directions(_POINTS)), byref(CHorizon()), c_int64(count),
        address(which), address(hidden),
    )  # fmt: skip
    return hidden[0] + hidden[1], hidden[1]


def bound(limits: SceneBounds) -> Bound:
    """Largest f_ms n.l for the scene's roughnesses, times the irradiance of all lights."""
    light = sum(light.irradiance for light in limits.lights)
    if light == 0.0 and limits.environment == 0.0:
        return Bound(0.0, "there is no light")
    tables = albedo()
    rows = np.linspace(0.0, 1.0, len(tables.average)) ** 2
    # One more row on either side: lookups interpolate.
    first = max(int(np.searchsorted(rows, limits.alpha[0], side="right")) - 1, 0)
    last = min(int(np.searchsorted(rows, limits.alpha[1])), len(rows) - 1)
    missing = 1.0 - tables.total[first : last + 1].min(axis=1)
    mean = tables.average[first : last + 1]
    strength = _strength(np.float32(limits.specular), mean)
    lobe = float((strength * missing**2 / np.maximum(1.0 - mean, 1e-6)).max())
    share = float((strength * missing).max())
    reason = f"F0 up to {limits.specular:.2g}, alpha up to {limits.alpha[1]:.2g}"
    # n.l <= 1; an environment's radiance counts times the lobe's albedo.
    return Bound(1.02 * (lobe / math.pi * light + share * limits.environment), reason)


def terms(specular: Array, near: Array, n_dot_v: Array) -> tuple[Array, Array]:
    """Factors of the lobe that do not depend on the light.

    Args:
        specular: F0.
        near: Albedo.near(alpha).
        n_dot_v: clamped to 0.

    Returns:
        Fms (1 - E(n.v)) / (pi (1 - Eavg)), the factor of (1 - E(n.l)) n.l; and Fms (1 - E(n.v)),
        the lobe's albedo.
    """
    tables = albedo()
    mean = tables.average_at(near)
    share = _strength(specular, mean) * tables.missing(near, n_dot_v)
    return share / (np.maximum(1.0 - mean, np.float32(1e-6)) * np.float32(math.pi)), share


def _strength(specular: Array | np.float32, mean: Array) -> Array:
    """Fms of F0 and Eavg."""
    fresnel = specular + (1.0 - specular) * np.float32(1.0 / 21.0)
    return fresnel * fresnel * mean / (1.0 - fresnel * (1.0 - mean))
