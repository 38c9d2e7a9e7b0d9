"""Options of what draws from the prior and of what blends two materials."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from matcap.files import values
from matcap.files.settings import check_settings, setting

SPREAD = 0.3  # how far from a training photograph's place materials are drawn; docs/notes/prior.md
_MOST_STEPS = 256


@dataclass(frozen=True)
class DrawOptions:
    """Where in the prior's space a material is drawn.

    Raises:
        UsageError: a number that is out of range.
    """

    like: Path | None = setting(None, metavar="PHOTO")
    """Draw near this flash photograph instead of anywhere in the space."""
    spread: float = setting(SPREAD, option="-t", least=0.0, most=1.0, metavar="0..1")
    """How far from there to draw: 0 is the photograph's own place, 1 anywhere."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class SampleOptions:
    """How many materials are drawn, from which prior.

    Raises:
        UsageError: a number that is out of range.
    """

    count: int = setting(16, option="-n", least=1, most=256)
    """How many."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Of the first; the others follow."""
    prior: Path | None = setting(None)
    """A prior's file, instead of the one that comes along."""
    materials: Path | None = setting(None, metavar="FOLDER")
    """Write the materials there, too, a .matcap file each."""

    def __post_init__(self) -> None:
        check_settings(self)


def shares(text: str | tuple[float, ...]) -> tuple[float, ...]:
    """'0.5' to one share, '0:1:5' to five from 0 to 1.

    Raises:
        ValueError: it is neither, or reaches outside.
    """
    if not isinstance(text, str):
        return text
    number = r"\d*\.?\d+|\d+\."
    match = re.fullmatch(rf"({number})(?::({number}):(\d{{1,9}}))?", text.strip())
    if not match:
        raise ValueError(f"'{text}' is neither a share such as 0.5 nor a range as 0:1:9")
    first = float(match[1])
    last, count = (float(match[2]), int(match[3])) if match[2] else (first, 1)
    if not (0 <= first <= 1 and 0 <= last <= 1):
        raise ValueError(f"'{text}' reaches outside 0 to 1")
    if count > _MOST_STEPS:
        raise ValueError(f"'{text}' asks for more than {_MOST_STEPS} steps")
    if count < (2 if match[2] else 1):
        raise ValueError(f"'{text}' asks for fewer than two steps")
    step = (last - first) / max(1, count - 1)
    return tuple(min(1.0, round(first + i * step, 6)) for i in range(count))


@dataclass(frozen=True)
class BlendOptions:
    """Which materials between two are made."""

    shares: tuple[float, ...] = setting(
        (0.5,), option="-t", metavar="T|FROM:TO:COUNT", parse=shares, otherwise="0.5"
    )
    """How far from A (0) to B (1), once or in up to 256 steps."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Which piece is shown on the strip."""

    def __post_init__(self) -> None:
        check_settings(self)
