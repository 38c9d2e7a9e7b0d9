"""Summary of an exemplar: its size, the period of its lattice, the share that is not used."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from matcap.example.example import Example, detail_bits, piece_sizes


@dataclass(frozen=True)
class Summary:
    """Of one exemplar."""

    size: tuple[int, int]
    """(width, height) in texels."""
    periods: tuple[float, ...]
    """Of its regular order, in texels."""
    left_out: float
    """Share that matches nothing else in it, as stains do: pieces do not begin there."""
    variety: float
    """How far its field takes it apart, from 0 to 1."""
    pieces: tuple[int, int]
    """(width, height) in texels of the pieces that the field is made of, at most."""
    texel_size: float
    """In plane units."""
    f0: tuple[float, ...] = ()
    """Mean specular albedo: one number, or three where it has a colour."""

    def document(self) -> dict[str, Any]:
        """The same for JSON."""
        periods = [round(period, 2) for period in self.periods]
        return {
            "size": list(self.size), "periods": periods, "left_out": self.left_out,
            "variety": self.variety, "pieces": list(self.pieces),
            "f0": [round(value, 4) for value in self.f0],
        }  # fmt: skip

    def pieces_text(self, millimetres: float | None = None) -> str:
        """How large the pieces are, in words.

        Args:
            millimetres: of a plane unit, where that is known.
        """
        longer = max(self.pieces)
        if millimetres is not None:
            return f"pieces of about {longer * self.texel_size * millimetres / 10.0:.2g} cm"
        return f"pieces of about {100 * longer / max(self.size):.0f} % of the photograph's width"

    def lines(self, millimetres: float | None = None) -> list[tuple[str, str]]:
        """Names, and a sentence each.

        Args:
            millimetres: of a plane unit, where that is known.
        """
        width, height = self.size
        order = "No regular order."
        if self.periods:
            periods = " and ".join(f"{period:.1f}" for period in self.periods)
            order = f"It repeats every {periods} texels."
        return [
            ("exemplar", f"{width} x {height} texels of the photographed piece."),
            ("order", order),
            ("variety", f"{self.variety:g}: {self.pieces_text(millimetres)}."),
            ("left out", f"{100 * self.left_out:.1f} % of it matches nothing else in it."),
            ("specular", self._specular()),
        ]

    def _specular(self) -> str:
        """What F0 is on average, in words."""
        mean = ", ".join(f"{value:.2g}" for value in self.f0)
        if len(self.f0) == 1:
            return f"F0 of {mean} on average, without a colour."
        return f"F0 of {mean} on average (red, green, blue): some of it is metal."


def summary(example: Example) -> Summary:
    """Size, period and unused share of an example."""
    order = example.index.order
    waves = () if order is None else order.waves
    side = 1 << detail_bits(example.exemplar)
    periods = tuple(side / math.hypot(*wave) for wave in waves)
    sizes = piece_sizes(example)
    wide, high = (sizes.width, sizes.height) if order is None else (round(sizes.cells),) * 2
    return Summary(
        example.exemplar.size,
        periods,
        example.index.left_out,
        example.variety,
        (wide * side, high * side),
        example.exemplar.texel_size,
        tuple(float(plane.mean(dtype=np.float64)) for plane in example.exemplar.specular),
    )
