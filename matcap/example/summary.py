"""What is told of an exemplar: how large it is, what it repeats in, what of it is not used."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from matcap.example.example import Example, detail_bits


@dataclass(frozen=True)
class Summary:
    """Of one exemplar.

    Attributes:
        size: (width, height) in texels.
        periods: of its regular order, in texels.
        left_out: share that matches nothing else in it, as stains do: pieces do not begin there.
    """

    size: tuple[int, int]
    periods: tuple[float, ...]
    left_out: float

    def document(self) -> dict[str, Any]:
        """The same for JSON."""
        periods = [round(period, 2) for period in self.periods]
        return {"size": list(self.size), "periods": periods, "left_out": self.left_out}

    def lines(self) -> list[tuple[str, str]]:
        """Names, and a sentence each."""
        width, height = self.size
        order = "No regular order."
        if self.periods:
            periods = " and ".join(f"{period:.1f}" for period in self.periods)
            order = f"It repeats every {periods} texels."
        return [
            ("exemplar", f"{width} x {height} texels of the photographed piece."),
            ("order", order),
            ("left out", f"{100 * self.left_out:.1f} % of it matches nothing else in it."),
        ]


def summary(example: Example) -> Summary:
    """What is told of an example."""
    order = example.index.order
    waves = () if order is None else order.waves
    side = 1 << detail_bits(example.exemplar)
    periods = tuple(side / math.hypot(*wave) for wave in waves)
    return Summary(example.exemplar.size, periods, example.index.left_out)
