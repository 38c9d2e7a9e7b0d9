"""Summary of an exemplar: size, periods of its lattice, unused share, variety, F0."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from matcap.example.example import Example, detail_bits, patch_sizes
from matcap.example.lookup import kept_lattice


@dataclass(frozen=True)
class Summary:
    """Summary of one exemplar."""

    size: tuple[int, int]
    """(width, height) in texels."""
    periods: tuple[float, ...]
    """Periods of its lattice in texels; empty without one."""
    left_out: float
    """Share that stands out, such as stains, which fields avoid."""
    variety: float
    """Variety in [0, 1]; see ReadOptions."""
    patches: tuple[int, int]
    """Largest (width, height) of the field's patches, texels."""
    texel_size: float
    """Side of a texel in plane units."""
    f0: tuple[float, ...] = ()
    """Mean specular albedo: one number, or three where it has a colour."""

    def document(self) -> dict[str, Any]:
        """The summary for JSON."""
        periods = [round(period, 2) for period in self.periods]
        return {
            "size": list(self.size), "periods": periods, "left_out": self.left_out,
            "variety": self.variety, "patches": list(self.patches),
            "f0": [round(value, 4) for value in self.f0],
        }  # fmt: skip

    def patches_text(self, millimetres: float | None = None) -> str:
        """Size of the patches as a phrase; `millimetres` is of a plane unit, if known."""
        longer = max(self.patches)
        if millimetres is not None:
            return f"patches of about {longer * self.texel_size * millimetres / 10.0:.2g} cm"
        return f"patches of about {100 * longer / max(self.size):.0f} % of the photograph's width"

    def lines(self, millimetres: float | None = None) -> list[tuple[str, str]]:
        """(name, sentence) of each entry; `millimetres` is of a plane unit, if known."""
        width, height = self.size
        lattice = "Not periodic."
        if self.periods:
            periods = " and ".join(f"{period:.1f}" for period in self.periods)
            lattice = f"It repeats every {periods} texels."
        return [
            ("exemplar", f"{width} x {height} texels of the photographed rectangle."),
            ("lattice", lattice),
            ("variety", f"{self.variety:g}: {self.patches_text(millimetres)}."),
            (
                "left out",
                f"{100 * self.left_out:.1f} % stands out, such as stains; fields avoid it.",
            ),
            ("specular", self._specular()),
        ]

    def _specular(self) -> str:
        """Mean F0 as a sentence."""
        mean = ", ".join(f"{value:.2g}" for value in self.f0)
        if len(self.f0) == 1:
            return f"Mean F0 {mean}, without a colour."
        return f"Mean F0 {mean} (red, green, blue): some of it is metal."


def summary(example: Example) -> Summary:
    """Summarise an example."""
    lattice = example.index.lattice
    waves = () if lattice is None else lattice.waves
    side = 1 << detail_bits(example.exemplar)
    periods = tuple(side / math.hypot(*wave) for wave in waves)
    sizes = patch_sizes(example)
    laid = kept_lattice(example.index, example.variety)
    wide, high = (sizes.width, sizes.height) if laid is None else (round(sizes.cells),) * 2
    return Summary(
        example.exemplar.size,
        periods,
        example.index.left_out,
        example.variety,
        (wide * side, high * side),
        example.exemplar.texel_size,
        tuple(float(plane.mean(dtype=np.float64)) for plane in example.exemplar.specular),
    )
