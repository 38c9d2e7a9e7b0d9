"""Options of what draws materials from the prior, and of what blends two; space is not loaded."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from matcap.files import values
from matcap.files.settings import CheckedSettings, setting

SPREAD = 0.3  # default distance from an anchor (space/prior/anchors.py); docs/notes/prior.md
_MOST_STEPS = 256


@dataclass(frozen=True)
class DrawOptions(CheckedSettings):
    """Options of drawing a material from the prior."""

    like: Path | None = setting(None, metavar="PHOTO")
    """Draw a material similar to this flash photograph's."""
    spread: float = setting(SPREAD, option="-t", least=0.0, most=1.0, metavar="0..1")
    """Distance of the draw from the photograph: 0 is the photograph, 1 is independent of it."""


@dataclass(frozen=True)
class SampleOptions(CheckedSettings):
    """Options of `matcap sample`."""

    count: int = setting(16, option="-n", least=1, most=256)
    """Number of materials."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Seed of the first material; the next ones add 1."""
    prior: Path | None = setting(None)
    """File of a prior, instead of the shipped one."""
    materials: Path | None = setting(None, metavar="FOLDER")
    """Also write each material to a .matcap file in this folder."""


def shares(text: str | tuple[float, ...]) -> tuple[float, ...]:
    """Parse '0.5' to one share, '0:1:5' to five from 0 to 1.

    Raises:
        ValueError: invalid text, or shares outside [0, 1].
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
class BlendOptions(CheckedSettings):
    """Options of `matcap blend`."""

    shares: tuple[float, ...] = setting(
        (0.5,), option="-t", metavar="T|FROM:TO:COUNT", parse=shares, otherwise="0.5"
    )
    """Share of B, from 0 (A) to 1 (B), once or in up to 256 steps."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Seed of the realisation shown on the strip."""
