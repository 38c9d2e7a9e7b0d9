"""Tuned constants of the seamless tile; measured in docs/notes/field.md."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RepeatSettings:
    """Constants of the seamless tile."""

    cells: int = 16
    """Parts a side whose medians low frequencies are fitted to. Fewer are less affected by stains,
    and resolve low frequencies less."""
    slow: int = 4
    """Half periods a side up to which frequencies are removed. More make repeats less visible, and
    remove more of a large pattern."""
    metal: float = 0.25
    """F0 of the brightest channel above which a texel is metal, where F0 has a colour. Gems have up
    to 0.17, metals 0.4 and more."""
    least: float = 0.66
    """Least share of a side that the tile keeps. Less gives more shifts to choose from."""
    most: float = 0.92
    """Largest share; the rest is overlap for the seam."""
    stretch: float = 0.02
    """Largest change of a shift to whole turns of a lattice, as a share of the shift."""
    search: int = 320
    """Texels of the exemplar's longer side in the search for shifts."""
    turn: float = 0.06
    """Largest dy / dx of a shift."""
    slanted: float = 1.15
    """Factor on the cost of a slanted shift, as resampling loses some of the finest detail."""
    disordered: float = 1.15
    """Factor on the cost of shifts that do not keep the lattice."""
    candidates: int = 8
    """Shifts whose seams are compared."""
    larger: float = 0.6
    """Reduction of the relative cost for a shift as long as the side."""
    length: float = 0.1
    """Cost of a step of the seam, standard deviations of a feature; it keeps seams short."""
    blur: float = 6.0
    """Texels over which the step at a seam is spread. Less shows the seam, more a halo."""
    calm: float = 1.0
    """Largest step across the tile's border over the mean step, in any map; see _usual_line."""


REPEAT = RepeatSettings()
