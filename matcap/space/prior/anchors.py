"""Anchors: the training photographs' positions in the prior's space, and draws near them.

Latent vectors of the training photographs are standardised. But a few hundred points leave most of
64 dimensions empty, and the decoder is untrained there. Materials are therefore drawn near anchors.
An anchor is a latent vector, a base (mean maps, see base.py) and a lattice. The base is modelled as

    base = A code + b + L rest,    rest ~ N(0, I).

A draw at distance t of an anchor z = (code, rest) is

    sqrt(1 - t^2) z + t e,    e ~ N(0, I),

which is the anchor at t = 0, independent of it at t = 1, and standard normal for any t if z is. The
lattice is the anchor's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.space.decoder import CODE_SIZE
from matcap.space.prior.base import VARYING, Base, base_from, varying
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class ConditionalMean:
    """Linear-Gaussian model of bases given latent vectors, fitted to the training photographs.

    base = A code + b + L rest,    rest ~ N(0, I)
    """

    matrix: Tensor
    """A, (VARYING, CODE_SIZE)."""
    offset: Tensor
    """Vector b, (VARYING,)."""
    spread: Tensor
    """L, (VARYING, VARYING) lower triangular."""

    def base(self, code: Tensor, rest: Tensor) -> Base:
        """A code + b + L rest; `rest` is (VARYING,)."""
        return base_from(self.matrix @ code + self.offset + self.spread @ rest)

    def rest(self, code: Tensor, base: Base) -> Tensor:
        """(VARYING,) whitened residual L^-1 (base - A code - b)."""
        residual = varying(base) - self.offset - self.matrix @ code
        return torch.linalg.solve_triangular(self.spread, residual[:, None], upper=False)[:, 0]


@dataclass(frozen=True)
class Anchor:
    """A position in the prior's space."""

    code: Tensor
    """(CODE_SIZE,) latent vector."""
    rest: Tensor
    """(VARYING,) whitened residual of the base."""
    waves: tuple[Wave, ...]
    """Lattice, in cycles per texel of a drawn material."""

    def near(self, spread: float, generator: torch.Generator) -> Anchor:
        """Draw a position at distance t = spread, in [0, 1]; see the module's equation."""
        drawn = torch.randn(CODE_SIZE + VARYING, generator=generator)
        kept = math.sqrt(1.0 - spread**2)
        here = kept * torch.cat([self.code, self.rest]) + spread * drawn
        return Anchor(here[:CODE_SIZE], here[CODE_SIZE:], self.waves)


@dataclass(frozen=True)
class Anchors:
    """Positions of the N training photographs."""

    codes: Tensor
    """(N, CODE_SIZE) standardised latent vectors."""
    rests: Tensor
    """(N, VARYING) whitened residuals of the base maps, `rest` in the module."""
    waves: Tensor
    """(N, 2, 2) frequencies (fx, fy) of two waves; (0, 0) for absent ones."""

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, index: int) -> Anchor:
        waves = tuple(Wave(fx, fy) for fx, fy in self.waves[index].tolist() if fx or fy)
        return Anchor(self.codes[index], self.rests[index], waves)

    def draw(self, spread: float, generator: torch.Generator) -> Anchor:
        """Draw a position near a random anchor."""
        index = int(torch.randint(len(self), (1,), generator=generator))
        return self[index].near(spread, generator)


def origin() -> Anchor:
    """The origin of the prior's space, without a lattice."""
    return Anchor(torch.zeros(CODE_SIZE), torch.zeros(VARYING), ())
