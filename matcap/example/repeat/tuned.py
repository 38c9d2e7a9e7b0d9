"""What is tuned of the piece made to repeat; measured in docs/notes/field.md."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RepeatSettings:
    """What is tuned of the piece made to repeat."""

    cells: int = 16
    """Medians a side that what is slow is fitted to; fewer follow stains less, and see less of what
    is slow."""
    slow: int = 4
    """Half waves over a side that are still slow: more takes away more of what makes repeats show,
    and of the drawing where that is large."""
    metal: float = 0.25
    """F0 of the brightest channel from which on a texel is metal, where F0 has a colour: gems have
    up to 0.17, metals 0.4 and more."""
    least: float = 0.66
    most: float = 0.92
    """Share of a side that is kept: less lets the cut choose among more, and shows less of the
    piece."""
    stretch: float = 0.02
    """Of whatever closes a lattice, as a share of the side."""
    search: int = 320
    """Texels of the longer side that shifts are looked for in."""
    turn: float = 0.06
    """How slanting shifts may be: a photograph is held as level as that."""
    slanted: float = 1.15
    """Times what a slanting shift's cut costs: straightening it costs a little of the finest
    detail."""
    disordered: float = 1.15
    """Times what cuts cost that keep no order."""
    candidates: int = 8
    """Shifts whose cuts are compared."""
    larger: float = 0.6
    """What a cut may cost more for the whole side kept instead of none of it."""
    length: float = 0.1
    """What a cut costs a texel where nothing differs, in standard deviations of a feature: straight
    cuts are shorter."""
    blur: float = 6.0
    """Texels over which what still differs at a cut is spread; less shows the cut, more shows a
    halo."""
    calm: float = 1.0
    """Steps across the border in those inside, in any map: more where no line is as calm."""


REPEAT = RepeatSettings()
