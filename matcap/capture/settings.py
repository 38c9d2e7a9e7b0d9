"""What the user decides of a capture and of what it writes, and what follows from it.

Each setting is defined once, here: options, matcap.toml and the reference pages read its range, its
default and its docstring from its field (files/settings.py). How captures are done beyond what
users decide: method.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from matcap.errors import UsageError
from matcap.files import values
from matcap.files.settings import check_settings, setting, typed_settings

if TYPE_CHECKING:
    from matcap.brdf.stated import NormalStyle
    from matcap.capture.method import Method
    from matcap.field.source import Generator
    from matcap.files.values import Region

QUICK_DETAIL = 512  # texels, for a first look: docs/notes/capture.md
DETAIL = 1024  # docs/notes/capture.md has what more and less of them buy
FINE_DETAIL = 2048  # likewise, of photographs that have so many
FINEST_DETAIL = 4000  # likewise: nearly all that 12 megapixels have
DETAILS = (QUICK_DETAIL, DETAIL, FINE_DETAIL, FINEST_DETAIL)
# Statistics by name (target.py makes each), and whether a file of weights goes with them.
STATISTICS: Mapping[str, bool] = MappingProxyType({"filterbank": False, "vgg19": True})
STATISTICS_WORDS = "|".join(f"{name}=FILE" if file else name for name, file in STATISTICS.items())
_STEP = 16  # texels: the least alignment that a material has
_BESIDES = 50_000_000  # bytes: material, preview and report, generously


@dataclass(frozen=True)
class Effort:
    """What a capture spends."""

    preset: str
    """Whose effort it is, a key of PRESETS."""
    adapted: int
    """Steps by which the piece is held to the photograph (piece/adapt.py)."""
    steps: int
    """Of fine-tuning, where a decoder is asked for."""
    places: int = 2
    """Windows a step of it; all see the same maps, so one more costs a fifth more."""
    matched: bool = True
    """Mean and contrast moved to the photograph's at the end (space/tuning/match.py)."""
    detail: int = FINE_DETAIL
    """Texels across of the piece, of a photograph that has so many."""

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
    """What textures are compared by."""

    name: str = "filterbank"
    """A key of choices.STATISTICS."""
    weights: Path | None = None
    """A file that goes with it, torchvision's of VGG-19; None for the filter bank."""

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
    """What the user decides of a capture.

    With a time limit or a target, and without steps, the preset is "reference": the limit alone
    decides when to stop.

    Raises:
        UsageError: a number or a word that its setting does not allow.
    """

    preset: str = setting("standard", words=tuple(PRESETS))
    """How much work: instant (a first look, on half the texels), draft (whether the shot will do),
    standard (what one photograph gives), high (held to it three times as long) or reference (on all
    texels of 12 megapixels)."""
    steps: int | None = setting(None, least=0, most=10_000_000)
    """Steps instead of the preset's: of adapting the piece, or of fine-tuning a decoder. Several
    photographs of one piece are solved, and have none."""
    time_limit: float | None = setting(
        None, least=0.001, most=1e7, option="time", metavar="TIME", parse=values.duration
    )
    """Have the whole of a capture end by then, in seconds: 90s, 2m; without steps the preset is
    reference then."""
    target: float | None = setting(None, least=0.01, most=1e6, metavar="TIMES")
    """With the decoder: stop at this error, in multiples of what the photograph's own windows
    differ by; without steps the preset is reference then."""
    detail: int | None = setting(None, least=64, most=8192, otherwise="the preset's")
    """Texels along the photograph's long side; by default as the preset has it where the photograph
    has so many pixels, and 1024 where it has not or a decoder is made."""
    fov: float | None = setting(
        None, least=1.0, most=170.0, metavar="1..170", otherwise="the photograph's"
    )
    """Field of view along the long side, degrees."""
    width_cm: float | None = setting(None, least=0.01, most=1e5)
    """What the photograph's long side spans, in centimetres: exports are true to scale."""
    crop: Region | None = setting(None, metavar="x,y,w,h", parse=values.region)
    """What of the photograph is the material, in its own pixels as it is looked at; the rest is
    left out."""
    mask: Path | None = setting(None, metavar="FILE.png")
    """A picture of the photograph's size: white is the material, black (a finger, a label, the
    table's edge) is left out."""
    camera: Path | None = setting(None, metavar="FILE.json")
    """Profile of the camera, as matcap camera and matcap batch write it: how much light its corners
    lose."""
    seed: int = setting(0, least=0, most=2**63 - 1)
    """Seed of the work and of the map set."""
    prior: str = setting("auto", metavar="auto|none|PATH")
    """With the decoder: trained prior to start from; auto is the one that comes with matcap, none
    starts from nothing."""
    statistics: Statistics = setting(Statistics(), metavar=STATISTICS_WORDS, parse=Statistics.parse)
    """What textures are compared by."""
    generator: Generator = setting("example", words=("decoder", "example"))
    """What the material is made by: the photographed piece, rearranged (example), or the paper's
    network, fine-tuned (decoder)."""
    union: bool = setting(False)
    """Of several photographs of one piece: the piece is all that they show, not the first one's
    rectangle alone."""
    aligned: bool = setting(False)
    """Also the maps of the photographed piece itself, NAME_photo, with confidence."""

    def __post_init__(self) -> None:
        check_settings(self)

    @staticmethod
    def of(named: Mapping[str, Any]) -> CaptureSettings:
        """Settings by name, perhaps in words; the rest as by default.

        Raises:
            TypeError: an unknown setting.
            UsageError: words that mean none.
        """
        return CaptureSettings(**typed_settings(CaptureSettings, named))

    def solves(self, photographs: int) -> bool:
        """Whether so many photographs of one piece are solved together: nothing is adapted."""
        return photographs > 1 and self.generator == "example"

    def of_sample(self, photographs: int) -> CaptureSettings:
        """Those of a sample of so many photographs in a batch, whose steps are of single ones."""
        return replace(self, steps=None) if self.solves(photographs) else self

    def named(self) -> dict[str, Any]:
        """All settings by name, as files record them: numbers, words and None."""
        document = asdict(self) | {"statistics": str(self.statistics), "union": self.union or None}
        # Unsaid where there is none, as in files of before there were any.
        document |= {
            name: part and str(part)
            for name, part in (("crop", self.crop), ("mask", self.mask), ("camera", self.camera))
        }
        unsaid = {"crop", "mask", "camera", "union"}
        return {name: value for name, value in document.items() if value or name not in unsaid}

    @property
    def millimetres_per_unit(self) -> float | None:
        """How long a plane unit is, half of the long side; None where it was not measured."""
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
class InspectSettings:
    """How photographs are inspected, before they are captured.

    Raises:
        UsageError: a number that is out of range.
    """

    detail: int = setting(DETAIL, least=64, most=8192)
    """Pixels across that a capture would look at."""
    together: bool | None = setting(None, otherwise="where the names are a set's: oak_1, oak_2")
    """All photographs show the same piece: say also what they show and lack together."""

    def __post_init__(self) -> None:
        check_settings(self)


def _known_targets(names: Sequence[str]) -> tuple[str, ...]:
    """Targets by name, each once.

    Raises:
        UsageError: there is no such target.
    """
    from matcap.export.targets import check_targets

    return check_targets(names)


@dataclass(frozen=True)
class OutputSettings:
    """What is written beside the material.

    Raises:
        UsageError: the size cannot tile.
    """

    size: tuple[int, int] = setting((1024, 1024), metavar="WxH", parse=values.sides_of)
    """Size of the first map set in texels: 2048x1024, or 2K, 4K, 8K."""
    seed: int = 0
    """Its realisation."""
    tile: bool | None = setting(None, otherwise="where the sides are multiples of 16")
    """A first map set that repeats without a seam."""
    png: bool = setting(False)
    """16-bit PNGs beside the EXR files."""
    normal: NormalStyle = setting("gl", words=("gl", "dx"))
    """Normals with +Y up (gl) or down (dx)."""
    targets: tuple[str, ...] = setting(
        (), option="export", metavar="TARGET", parse=_known_targets, several=True
    )
    """Also for this renderer or engine, into a folder of its name; see matcap export. May be given
    several times."""

    def __post_init__(self) -> None:
        check_settings(self)
        width, height = self.size
        if self.tile and (width % _STEP or height % _STEP):
            raise UsageError(
                f"{width}x{height} cannot tile",
                where="size",
                remedy=f"give sides that are multiples of {_STEP}",
            )

    def repeats(self, alignment: int) -> bool:
        """Whether the map set of a material of this alignment repeats without a seam."""
        fits = all(side % alignment == 0 for side in self.size)
        return fits if self.tile is None else self.tile

    @property
    def room(self) -> int:
        """Bytes of disk that the outputs take at most."""
        from matcap.brdf.folder import mapset_bytes
        from matcap.export.targets import export_bytes

        exports = len(self.targets) * export_bytes(*self.size)
        return mapset_bytes(*self.size, png=self.png) + exports + _BESIDES


def check_photographs(settings: CaptureSettings, photographs: int) -> None:
    """Refuse what a capture of so many photographs of one piece cannot honour.

    Raises:
        UsageError: a union of one photograph, or steps of several.
    """
    if settings.union and photographs < 2:
        raise UsageError(
            "one photograph cannot be extended by others",
            where="--union",
            remedy="give two or more of one piece, and --together",
        )
    if settings.steps is not None and settings.solves(photographs):
        raise UsageError(
            "several photographs are solved in one pass, without steps",
            where="--steps",
            remedy="leave it out, or give --generator decoder",
        )


def resolve(
    settings: CaptureSettings, method: Method | None = None, photographs: int = 1
) -> Effort:
    """What a capture with these settings spends.

    Args:
        settings: what the user decides.
        method: how it is done.
        photographs: of one piece; several are solved, and not adapted.

    Raises:
        UsageError: an unknown preset.
    """
    if settings.preset not in PRESETS:
        raise UsageError(
            f"there is no preset {settings.preset!r}", remedy=f"choose one of {', '.join(PRESETS)}"
        )
    if settings.target is not None and settings.generator != "decoder":
        raise UsageError(
            "only fine-tuning of a decoder has a target",
            where="--target",
            remedy="give --generator decoder with it, or --time in its place",
        )
    if settings.union and settings.generator == "decoder":
        raise UsageError(
            "a decoder uses no exemplar that could be extended",
            where="--union",
            remedy="leave out --union or --generator decoder",
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
    if settings.solves(photographs):
        effort = replace(effort, adapted=0)
    return effort
