"""What the user decides of a capture, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from matcap.capture.choices import CHOICES, STATISTICS, STATISTICS_WORDS, check
from matcap.capture.detail import DETAIL, DETAILS, FINE_DETAIL, FINEST_DETAIL, QUICK_DETAIL
from matcap.errors import UsageError
from matcap.field.source import Generator
from matcap.files.values import Region, region
from matcap.statistics.filterbank import FilterBankConfig

if TYPE_CHECKING:
    from matcap.space.decoder import DecoderConfig

FEATURES = FilterBankConfig(sizes=(5,), filters=64)


@dataclass(frozen=True)
class Effort:
    """What a capture spends.

    Attributes:
        preset: whose effort it is, a key of PRESETS.
        adapted: steps by which the piece is held to the photograph (piece/adapt.py).
        steps: of fine-tuning, where a decoder is asked for.
        places: windows a step of it; all see the same maps, so one more costs a fifth more.
        matched: mean and contrast moved to the photograph's at the end (space/tuning/match.py).
        detail: texels across of the piece, of a photograph that has so many.
    """

    preset: str
    adapted: int
    steps: int
    places: int = 2
    matched: bool = True
    detail: int = FINE_DETAIL

    def work(self, generator: Generator) -> int:
        """Steps of what makes a generator."""
        return self.steps if generator == "decoder" else self.adapted


# docs/notes/accuracy-and-time.md has what each costs and buys, beside what else could be done.
PRESETS: Mapping[str, Effort] = MappingProxyType(
    {
        effort.preset: effort
        for effort in (
            Effort("instant", 0, 0, detail=QUICK_DETAIL),
            Effort("draft", 16, 32, matched=False, detail=QUICK_DETAIL),
            Effort("standard", 40, 160, places=3),
            Effort("high", 120, 320, places=3),
            Effort("reference", 120, 800, detail=FINEST_DETAIL),
        )
    }
)
# Where a time limit or a target alone decides when to stop: as many steps as there are.
UNLIMITED = "reference"
# Seconds that a limit leaves for so many texels: with less they would take it all.
TIME_FOR_DETAIL = ((60.0, FINE_DETAIL), (20.0, DETAIL), (0.0, QUICK_DETAIL))


@dataclass(frozen=True)
class Statistics:
    """What textures are compared by.

    Attributes:
        name: a key of choices.STATISTICS.
        weights: a file that goes with it, torchvision's of VGG-19; None for the filter bank.
    """

    name: str = "filterbank"
    weights: Path | None = None

    def __str__(self) -> str:
        return self.name if self.weights is None else f"{self.name}={self.weights}"

    @staticmethod
    def parse(text: str | Statistics) -> Statistics:
        """The statistics that "filterbank" or "vgg19=FILE" means.

        Raises:
            UsageError: there is none of this name, or a file is missing or too many.
        """
        if isinstance(text, Statistics):
            return text
        name, given, path = text.partition("=")
        wanted = STATISTICS.get(name)
        if wanted is None or bool(wanted) != bool(given and path) or bool(given) != bool(path):
            raise UsageError(
                f"there are no statistics {text!r}",
                remedy=f"choose {STATISTICS_WORDS.replace('|', ' or ')}",
            )
        return Statistics(name, Path(path) if path else None)


@dataclass(frozen=True)
class CaptureSettings:
    """What the user decides.

    Attributes:
        preset: a key of PRESETS.
        steps: instead of the preset's: of adapting the piece, or of fine-tuning a decoder.
        time_limit: for the whole work in seconds, or None.
        target: error of a decoder to end at, as a multiple of what the photograph's own windows
            differ by.
        detail: texels across the photograph's long side, instead of the preset's where the
            photograph has so many pixels, and DETAIL where it has not or a decoder is made.
        fov: field of view across the long side in degrees, instead of the photograph's.
        seed: of everything random.
        prior: "auto" (the one that comes with matcap), "none" (start from nothing) or a file.
        statistics: that textures are compared by.
        generator: that the material is read by: "example" (the photographed piece, rearranged) or
            "decoder" (the paper's network, fine-tuned).
        aligned: the maps of the photographed piece itself are found, too.
        width_cm: what the photograph's long side spans, in centimetres; None where nobody measured
            it.
        crop: what of the photograph is the material, in its own pixels as it is looked at.
        mask: a picture of the photograph's size, white where it is the material.
        union: of several photographs, the piece is all that they show, instead of the first one's
            rectangle.

    With a time limit or a target, and without steps, the preset is "reference": the limit alone
    decides when to stop.

    Raises:
        UsageError: a number outside the limits of its setting (choices.py).
    """

    preset: str = "standard"
    steps: int | None = None
    time_limit: float | None = None
    target: float | None = None
    detail: int | None = None
    fov: float | None = None
    seed: int = 0
    prior: str = "auto"
    statistics: Statistics = Statistics()
    generator: Generator = "example"
    aligned: bool = False
    width_cm: float | None = None
    crop: Region | None = None
    mask: Path | None = None
    union: bool = False

    def __post_init__(self) -> None:
        for name in CHOICES:
            check(name, getattr(self, name))

    @staticmethod
    def of(named: Mapping[str, Any]) -> CaptureSettings:
        """Settings by name, statistics perhaps in words; the rest as by default.

        Raises:
            TypeError: an unknown setting.
            UsageError: unknown statistics.
        """
        typed: dict[str, Any] = {
            "statistics": Statistics.parse(named.get("statistics", Statistics()))
        }
        if named.get("mask") is not None:
            typed["mask"] = Path(named["mask"])
        try:
            if named.get("crop") is not None:
                typed["crop"] = region(named["crop"])
        except ValueError as error:
            raise UsageError(str(error), where="--crop", remedy="give x,y,w,h") from error
        return CaptureSettings(**{**named, **typed})

    def named(self) -> dict[str, Any]:
        """All settings by name, as files tell of them: numbers, words and None."""
        told = asdict(self) | {"statistics": str(self.statistics), "union": self.union or None}
        # Unsaid where there is none, as in files of before there were any.
        told |= {
            name: part and str(part) for name, part in (("crop", self.crop), ("mask", self.mask))
        }
        unsaid = {"crop", "mask", "union"}
        return {name: value for name, value in told.items() if value or name not in unsaid}

    @property
    def millimetres_per_unit(self) -> float | None:
        """How long a plane unit is, half of the long side; None where nobody measured it."""
        return None if self.width_cm is None else 10.0 * self.width_cm / 2.0

    @property
    def most_detail(self) -> int:
        """Texels along the long side that a photograph has to be read with.

        Raises:
            UsageError: an unknown preset.
        """
        by_default = DETAIL if self.generator == "decoder" else resolve(self).detail
        return self.detail or by_default

    def detail_of(self, pixels: int) -> int:
        """Texels across a photograph that was read with so many pixels along its long side."""
        most = self.most_detail
        has = (texels for texels in DETAILS if texels <= min(most, pixels))
        return self.detail or max((min(most, DETAIL), *has))


@dataclass(frozen=True)
class Method:
    """How it is done: nothing that users decide, but what the laboratory measures.

    Attributes:
        window: texels a side of what is compared; many cheap steps beat few exact ones.
        features: that textures are compared by.
        decoder: shape of the decoder, where there is no prior to say it, or None.
        half_precision: bfloat16 inside the network and the features, where the processor computes
            with it.
        places: windows a step, instead of the preset's.
        matched: at the end, instead of as the preset says.
        adapted: steps of the exemplar, instead of the preset's.
    """

    window: int = 160
    features: FilterBankConfig = FEATURES
    decoder: DecoderConfig | None = None
    half_precision: bool = True
    places: int | None = None
    matched: bool | None = None
    adapted: int | None = None


def resolve(settings: CaptureSettings, method: Method | None = None) -> Effort:
    """What a capture with these settings spends.

    Raises:
        UsageError: an unknown preset.
    """
    if settings.preset not in PRESETS:
        raise UsageError(
            f"there is no preset {settings.preset!r}", remedy=f"choose one of {', '.join(PRESETS)}"
        )
    if settings.target is not None and settings.generator != "decoder":
        raise UsageError(
            "a target is an error of the decoder",
            where="--target",
            remedy="give --generator decoder with it, or --time in its place",
        )
    if settings.union and settings.generator == "decoder":
        raise UsageError(
            "a decoder has no piece that could be larger",
            where="--union",
            remedy="leave it out, or --generator decoder",
        )
    effort = PRESETS[settings.preset]
    if settings.steps is not None:
        effort = replace(effort, steps=settings.steps, adapted=settings.steps)
    elif settings.time_limit is not None or settings.target is not None:
        effort = PRESETS[UNLIMITED]
        limit = settings.time_limit or math.inf
        detail = next(texels for least, texels in TIME_FOR_DETAIL if limit >= least)
        effort = replace(effort, detail=detail)
    if method is not None and method.places is not None:
        effort = replace(effort, places=method.places)
    if method is not None and method.matched is not None:
        effort = replace(effort, matched=method.matched)
    if method is not None and method.adapted is not None:
        effort = replace(effort, adapted=method.adapted)
    return effort
