"""Options of reading maps from a material, of draws from the prior and of blends."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from matcap.files import settings as values
from matcap.files.settings import CheckedSettings, setting

if TYPE_CHECKING:
    from matcap.brdf.adjust import Adjustments
    from matcap.brdf.stated import NormalSource
    from matcap.field.source import Generator

# Options of reading maps from a material or a map set, shared by several commands.


def _adjustments(text: str | Adjustments) -> Adjustments:
    """parse_adjustments, imported on demand as it needs NumPy."""
    from matcap.brdf.adjust import parse_adjustments

    return parse_adjustments(text) if isinstance(text, str) else text


@dataclass(frozen=True)
class ReadOptions(CheckedSettings):
    """Options of reading maps."""

    generator: Generator | None = setting(
        None,
        words=("example", "decoder"),
        otherwise="the one that capture found nearer",
        group="Decoder",
    )
    """Rearrange the photographed rectangle (example), or run the fine-tuned network (decoder)."""
    adjust: Adjustments | None = setting(
        None, metavar="NAME=VALUE,...", parse=_adjustments, group="Advanced"
    )
    """Change relief (factor), roughness (added), saturation, brightness (factors) or tint (#rrggbb)
    of the maps, not of the material: relief=1.3,roughness=-0.1. Or a sidecar (.json) that records
    it."""
    variety: float | None = setting(
        None, least=0.0, most=1.0, metavar="0..1", otherwise="what capture chose", group="Advanced"
    )
    """Size of the patches that the exemplar is cut into: 0 is one patch, the whole exemplar; 1 is
    the smallest patches."""
    normals: NormalSource | None = setting(
        None, words=("height", "file"), otherwise="height", group="Advanced"
    )
    """Normals of a map set: computed from its height, or read from its normal file."""

    @property
    def adjustments(self) -> Adjustments:
        """The adjustments; NONE where there are none."""
        from matcap.brdf.adjust import NONE

        return self.adjust or NONE


AS_IT_IS = ReadOptions()

# Options of what draws materials from the prior, and of what blends two; space is not loaded.

SPREAD = 0.3  # default distance from an anchor (space/prior/store.py); docs/notes/prior.md
_MOST_STEPS = 256


@dataclass(frozen=True)
class DrawOptions(CheckedSettings):
    """Options of drawing a material from the prior."""

    like: Path | None = setting(None, metavar="PHOTO|MATERIAL", group="Decoder")
    """Draw a material similar to that of this photograph, or to this captured one."""
    spread: float = setting(
        SPREAD, option="-t", least=0.0, most=1.0, metavar="0..1", group="Decoder"
    )
    """Distance of the draw from it: 0 is the photograph, 1 is independent of it."""


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

    generator: Generator | None = setting(
        None, words=("example", "decoder"), otherwise="the ones that make their maps"
    )
    """Interpolate the exemplars (example), or the networks through the space (decoder)."""
    shares: tuple[float, ...] = setting(
        (0.5,), option="-t", metavar="T|FROM:TO:COUNT", parse=shares, otherwise="0.5"
    )
    """Share of B, from 0 (A) to 1 (B), once or in up to 256 steps."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Seed of the realisation shown on the strip."""
