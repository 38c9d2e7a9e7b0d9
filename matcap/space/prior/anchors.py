"""Anchors in the space: where photographs lie in it, and what lies near them.

An anchor is a code, the base that goes with it and its regular order. Codes are standard normal
over all the training photographs together, but not between them: a few hundred places in 64
dimensions leave most of the space near none. So materials are drawn near photographs' places, and
each brings its order along, without which nothing is woven.

A base is modelled by its conditional mean: base = A code + b + L rest, with rest standard normal.
Code and rest of an anchor z move to

    sqrt(1 - t^2) z + t e,    e standard normal,

so t = 0 is the anchor itself and t = 1 a draw that knows nothing of it but its order; what is
standard normal stays so, whatever t is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.space.decoder import CODE_SIZE
from matcap.space.prior.base import VARYING, Base, base_from, varying
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class ConditionalMean:
    """Linear-Gaussian model of bases given codes, fitted to the training photographs.

    base = A code + b + L rest,    rest ~ N(0, I)
    """

    matrix: Tensor
    """A, (VARYING, CODE_SIZE)."""
    offset: Tensor
    """B, (VARYING,)."""
    spread: Tensor
    """L, (VARYING, VARYING) lower triangular."""

    def base(self, code: Tensor, rest: Tensor) -> Base:
        """The base of a code and a rest (VARYING,)."""
        return base_from(self.matrix @ code + self.offset + self.spread @ rest)

    def rest(self, code: Tensor, base: Base) -> Tensor:
        """(VARYING,) the whitened residual L^-1 (base - A code - b)."""
        residual = varying(base) - self.offset - self.matrix @ code
        return torch.linalg.solve_triangular(self.spread, residual[:, None], upper=False)[:, 0]


@dataclass(frozen=True)
class Anchor:
    """A place in the space."""

    code: Tensor
    """(CODE_SIZE,)."""
    rest: Tensor
    """(VARYING,) the whitened residual of the base given the code."""
    waves: tuple[Wave, ...]
    """Of its regular order, at a drawn material's fineness."""

    def near(self, spread: float, generator: torch.Generator) -> Anchor:
        """A random place near this one.

        Args:
            spread: how far away, from 0 (here) to 1 (anywhere).
            generator: of the random numbers.
        """
        drawn = torch.randn(CODE_SIZE + VARYING, generator=generator)
        kept = math.sqrt(1.0 - spread**2)
        here = kept * torch.cat([self.code, self.rest]) + spread * drawn
        return Anchor(here[:CODE_SIZE], here[CODE_SIZE:], self.waves)


@dataclass(frozen=True)
class Anchors:
    """Where the training photographs lie."""

    codes: Tensor
    """(N, CODE_SIZE)."""
    rests: Tensor
    """(N, VARYING)."""
    waves: Tensor
    """(N, 2, 2) frequencies (fx, fy) of at most two waves; (0, 0) for an absent one."""

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, index: int) -> Anchor:
        waves = tuple(Wave(fx, fy) for fx, fy in self.waves[index].tolist() if fx or fy)
        return Anchor(self.codes[index], self.rests[index], waves)

    def draw(self, spread: float, generator: torch.Generator) -> Anchor:
        """A random place near a random one of them."""
        index = int(torch.randint(len(self), (1,), generator=generator))
        return self[index].near(spread, generator)


def nowhere() -> Anchor:
    """The middle of the space: where nothing is known."""
    return Anchor(torch.zeros(CODE_SIZE), torch.zeros(VARYING), ())


def anchors_of(places: Sequence[Anchor]) -> Anchors:
    """Several as one."""
    waves = torch.zeros(len(places), 2, 2)
    for row, place in zip(waves, places, strict=True):
        for slot, wave in zip(row, place.waves, strict=False):
            slot.copy_(torch.tensor([wave.fx, wave.fy]))
    codes = torch.stack([place.code for place in places])
    return Anchors(codes, torch.stack([place.rest for place in places]), waves)
