"""User settings of a capture, the effort and time limit that follow from them, and progress."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from enum import Enum
from itertools import accumulate, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from matcap.errors import UsageError
from matcap.files import settings as values
from matcap.files.names import Progress, ignore_progress
from matcap.files.process import postponed
from matcap.files.settings import CheckedSettings, setting, typed_settings

if TYPE_CHECKING:
    from matcap.brdf.stated import NormalStyle
    from matcap.field.source import Generator
    from matcap.files.settings import Rectangle

# Each setting is defined once, here: options, matcap.toml and the reference pages take its range,
# default and docstring from its field (files/settings.py). Variants for experiments: `Method` in
# rectified.py.

# Texels along the long side; docs/notes/capture.md compares quality and time.
QUICK_DETAIL = 512
DETAIL = 1024
FINE_DETAIL = 2048
DETAILS = (QUICK_DETAIL, DETAIL, FINE_DETAIL)
UNION_TIMES = 4  # largest exemplar of several photographs, in texels of the first one's
# Settings that only the decoder uses, and their options.
_OF_DECODER = {"steps": "--steps", "prior": "--prior", "drawing": "--no-drawing"}
# Settings that take the place of what the photograph says, of one photograph by example.
_BY_HAND = ("metal", "albedo", "roughness")
_STEP = 16  # texels: smallest alignment of a material
_OTHER_FILES = 50_000_000  # bytes: upper bound of material, preview and report


@dataclass(frozen=True)
class Effort:
    """Amount of work of a capture."""

    preset: str
    """Its key in PRESETS."""
    steps: int
    """Steps of fine-tuning a decoder; 0 without one."""
    places: int = 2
    """Windows per step of fine-tuning; each beyond the first adds a fifth of a step's time, as all
    are rendered from the same maps."""
    matched: bool = True
    """Match a decoder's mean and contrast after fine-tuning (space/tuning/match.py)."""
    detail: int = FINE_DETAIL
    """Texels along the exemplar's long side, at most the photograph's pixels."""
    decoder_steps: int = 0
    """Steps of fine-tuning a decoder beside the exemplar of one photograph; 0 without one."""


# docs/notes/accuracy-and-time.md compares their accuracy and time.
PRESETS: Mapping[str, Effort] = MappingProxyType(
    {
        effort.preset: effort
        for effort in (
            Effort("instant", 0, detail=QUICK_DETAIL),
            Effort("draft", 32, matched=False, detail=DETAIL),
            Effort("standard", 112, places=3, decoder_steps=20),
        )
    }
)
# Under a time limit, so that it ends the work rather than the step count.
UNLIMITED = Effort("standard", 800)
# (least time limit in seconds, detail): a capture with more texels would exceed a shorter limit.
TIME_FOR_DETAIL = ((75.0, FINE_DETAIL), (26.0, DETAIL), (0.0, QUICK_DETAIL))


@dataclass(frozen=True)
class CaptureSettings(CheckedSettings):
    """User settings of a capture.

    With a time limit, and without steps, the steps are those of UNLIMITED, so that only
    the limit ends the work.
    """

    preset: str = setting("standard", words=tuple(PRESETS))
    """Texels across: 512, 1024, or 2048 and a decoder. Instant is a preview; a decoder alone has
    1024, and 0, 32 or 112 steps of fine-tuning."""
    steps: int | None = setting(None, least=0, most=10_000_000, group="Decoder")
    """With the decoder: steps of fine-tuning, instead of the preset's."""
    time_limit: float | None = setting(
        None, least=0.001, most=1e7, option="time", metavar="TIME", parse=values.duration
    )
    """Time limit of it all: 90s, 2m. It determines the texels instead of the preset and,
    without --steps, the steps of a decoder; one that this machine cannot keep is refused."""
    detail: int | None = setting(
        None, least=64, most=8192, otherwise="the preset's", group="Advanced"
    )
    """Texels along the photograph's long side; by default the preset's if the photograph has as
    many pixels, and 1024 otherwise or with the decoder."""
    fov: float | None = setting(
        None,
        least=1.0,
        most=170.0,
        metavar="1..170",
        otherwise="the photograph's",
        group="Advanced",
    )
    """Field of view along the long side, degrees."""
    white: float | None = setting(
        None, least=1e-9, most=1e9, otherwise="the file's, or 1", group="Advanced"
    )
    """Value that is white in files of floating-point numbers (EXR, HDR, TIFF, DNG): light above it
    is measured, and darker exposures of one scene stay comparable."""
    metal: bool | None = setting(
        None, off="--dielectric", otherwise="as the photograph shows", group="Advanced"
    )
    """The material is metal, or none; by default the more probable, or a mixture of both."""
    albedo: float | None = setting(
        None, least=0.005, most=1.0, otherwise="the most probable", group="Advanced"
    )
    """Mean albedo (of metal: F0) by another measurement, such as 0.18: a photograph without the
    strength of its flash does not say it."""
    roughness: float | None = setting(
        None, least=0.02, most=1.0, otherwise="the photograph's", group="Advanced"
    )
    """Mean roughness by another measurement."""
    width_cm: float | None = setting(None, least=0.01, most=1e5, group="Output")
    """Length of the sample along the photograph's long side, centimetres: exports are true to
    scale."""
    crop: Rectangle | None = setting(None, metavar="x,y,w,h", parse=values.region)
    """Rectangle to capture, pixels of the photograph as displayed."""
    mask: Path | None = setting(None, metavar="FILE.png", group="Advanced")
    """Picture of the photograph's size: white is captured, black (a finger, a label, the table's
    edge) is left out."""
    seed: int = setting(0, least=0, most=2**63 - 1, group="Advanced")
    """Seed of the optimisation and of the map set."""
    prior: str = setting("auto", metavar="auto|none|PATH", group="Decoder")
    """With the decoder: trained prior to start from; auto is the one that comes with matcap, none a
    random initialisation."""
    generator: Generator | None = setting(
        None,
        words=("decoder", "example"),
        otherwise="both by the preset standard, of one photograph",
        group="Decoder",
    )
    """Only one generator: the maps of the photographed rectangle, rearranged (example), or the
    paper's network, fine-tuned (decoder). Of both, the nearer makes the maps."""
    drawing: bool = setting(True, group="Decoder")
    """With the decoder: add log luminance and relief of the rearranged exemplar to its inputs, so
    that the material has the photograph's pattern; without, its input is noise alone, as in the
    paper."""
    union: bool = setting(False, group="Several photographs")
    """Maps of all that several photographs of one sample show, not only of the first one's
    rectangle."""
    aligned: bool = setting(False, group="Output")
    """Also write the maps of the photographed rectangle itself, NAME_photo, with confidence."""

    @staticmethod
    def of(named: Mapping[str, Any]) -> CaptureSettings:
        """Settings from names and values, which may be text; all others are defaults.

        Raises:
            UsageError: a name is unknown, or a value cannot be parsed.
        """
        return CaptureSettings(**typed_settings(CaptureSettings, named))

    @property
    def draws(self) -> bool:
        """Whether a decoder is captured that reads a drawing: without a step it cannot learn to."""
        return resolve(self).steps > 0 and self.drawing

    def named(self) -> dict[str, Any]:
        """All settings by name as JSON values."""
        document = asdict(self) | {"union": self.union or None}
        # Omitted if unset, as in files written before these settings existed.
        for name in ("white", "generator", *_BY_HAND):
            if document[name] is None:
                del document[name]
        document |= {"crop": self.crop and str(self.crop), "mask": self.mask and str(self.mask)}
        unsaid = {"crop", "mask", "union"}
        return {name: value for name, value in document.items() if value or name not in unsaid}

    @property
    def millimetres_per_unit(self) -> float | None:
        """Length of a plane unit, half of the long side, in mm; None without `width_cm`."""
        return None if self.width_cm is None else 10.0 * self.width_cm / 2.0

    @property
    def most_detail(self) -> int:
        """Pixels along the long side at which to read a photograph.

        Raises:
            UsageError: the preset is unknown.
        """
        if self.generator == "decoder":
            return self.detail or DETAIL
        return resolve(self).detail

    def detail_of(self, pixels: int) -> int:
        """Texels along the long side of a photograph that has `pixels` there."""
        most = self.most_detail
        has = (texels for texels in DETAILS if texels <= min(most, pixels))
        return self.detail or max((min(most, DETAIL), *has))


@dataclass(frozen=True)
class InspectSettings(CheckedSettings):
    """Settings of `matcap inspect`."""

    detail: int = setting(DETAIL, least=64, most=8192, group="Advanced")
    """Pixels along the long side at which to read the photographs."""
    details: bool = setting(False)
    """All checks of each photograph, as of a single one; by default a line for each of several."""
    together: bool | None = setting(None, otherwise="if names are numbered: oak_1, oak_2")
    """All photographs show the same sample: also report what they cover and lack together."""


def _known_targets(names: Sequence[str]) -> tuple[str, ...]:
    """Names of export targets without repetitions.

    Raises:
        UsageError: a name is unknown.
    """
    if not names:  # targets take a second to import
        return ()
    from matcap.export.targets import check_targets

    return check_targets(names)


@dataclass(frozen=True)
class OutputSettings(CheckedSettings):
    """User settings of the outputs next to the material.

    Raises:
        UsageError: `tile` is set and the size cannot tile.
    """

    size: tuple[int, int] = setting((1024, 1024), metavar="WxH", parse=values.size)
    """Texels of the first map set: 2048x1024, 2K, 4K, 8K."""
    seed: int = 0
    """Seed of the first map set."""
    tile: bool | None = setting(None, otherwise="if the sides are multiples of 16", group="Output")
    """Make a first map set that repeats without a seam."""
    maps: Literal["png", "jpg"] | None = setting(None, words=("png", "jpg"))
    """Also write what engines want, in the folder `maps`. This is base colour, metallic, roughness,
    normal, height and ambient occlusion."""
    png: bool = setting(False, group="Output")
    """Write 16-bit PNGs in addition to EXR files."""
    normal: NormalStyle = setting("gl", words=("gl", "dx"), group="Output")
    """Normals with +Y up (gl) or down (dx)."""
    targets: tuple[str, ...] = setting(
        (), option="export", metavar="TARGET", parse=_known_targets, several=True, group="Output"
    )
    """Also export for this renderer or engine, into a folder of its name; see matcap export.
    Repeatable."""

    def __post_init__(self) -> None:
        super().__post_init__()
        width, height = self.size
        if self.tile and (width % _STEP or height % _STEP):
            raise UsageError.at(
                "size", f"{width}x{height} cannot tile", f"give sides that are multiples of {_STEP}"
            )

    def repeats(self, alignment: int) -> bool:
        """Whether the map set of a material with this alignment, texels, repeats without a seam."""
        fits = all(side % alignment == 0 for side in self.size)
        return fits if self.tile is None else self.tile

    @property
    def room(self) -> int:
        """Upper bound of the outputs' size on disk, bytes."""
        from matcap.brdf.folder import mapset_bytes

        room = mapset_bytes(*self.size, png=self.png) + _OTHER_FILES
        if self.targets or self.maps:
            from matcap.export.targets import export_bytes

            room += (len(self.targets) + bool(self.maps)) * export_bytes(*self.size)
        return room


def prior_file(prior: str) -> Path | None:
    """File of a prior named "auto" (the shipped one) or by its path; None for "none".

    Raises:
        MatcapError: the named file is no prior.
    """
    from matcap.space.prior import SHIPPED

    if prior == "none":
        return None
    if prior == "auto":
        return SHIPPED
    from matcap.space.prior.store import load_prior  # takes a second

    load_prior(Path(prior))  # a broken one would fail for every photograph of a batch
    return Path(prior)


def check_photographs(settings: CaptureSettings, photographs: int) -> None:
    """Check settings against the number of photographs of a sample.

    Raises:
        UsageError: `union` is set for one photograph, or the decoder for several; a property is
            given by hand for several, or for a decoder.
    """
    if settings.generator == "decoder" and photographs > 1:
        raise UsageError.at(
            "--generator decoder",
            "the decoder is fine-tuned to one photograph",
            "give one, or leave it out",
        )
    given = [name for name in _BY_HAND if getattr(settings, name) is not None]
    if given and (photographs > 1 or (settings.generator == "decoder" and given != ["metal"])):
        raise UsageError.at(
            f"--{given[-1]}", "this is of one photograph, by example", "leave it out"
        )
    if settings.union and photographs < 2:
        raise UsageError.at(
            "--union",
            "this needs several photographs",
            "give two or more of one sample, and --together",
        )


def resolve(settings: CaptureSettings) -> Effort:
    """Effort of a capture with these settings.

    Raises:
        UsageError: the preset is unknown, or a setting contradicts the generator.
    """
    if settings.preset not in PRESETS:
        raise UsageError(
            f"there is no preset {settings.preset!r}", remedy=f"choose one of {', '.join(PRESETS)}"
        )
    if settings.generator != "decoder":
        default = CaptureSettings()
        for name, option in _OF_DECODER.items():
            if getattr(settings, name) != getattr(default, name):
                raise UsageError.at(
                    option,
                    "only a decoder uses this",
                    'give --generator decoder (generator = "decoder") with it, or leave it out',
                )
    if settings.union and settings.generator == "decoder":
        raise UsageError.at(
            "--union",
            "the decoder has no exemplar to extend",
            "leave out --union or --generator decoder",
        )
    effort = PRESETS[settings.preset]
    if settings.steps is not None:
        effort = replace(effort, steps=settings.steps)
    elif settings.time_limit is not None:
        limit = settings.time_limit
        detail = next(texels for least, texels in TIME_FOR_DETAIL if limit >= least)
        effort = replace(UNLIMITED, detail=detail)
    if settings.detail is not None:
        effort = replace(effort, detail=settings.detail)
    if settings.generator == "decoder":
        return effort
    both = settings.generator is None and settings.time_limit is None
    return replace(effort, steps=effort.decoder_steps if both else 0)


# Whether a capture keeps its time limit on this machine, and the detail that fits into it.

# Seconds of the shortest capture, from the command's start to its end, on one idle thread of a
# machine that does `slowness`'s work in _WORK seconds.
LEAST_TIME, _WORK = 12.0, 0.07
_VARIES = 1.25  # factor by which a busy machine may become slower during a capture
_EACH = 0.25  # share of that which each further photograph of a set adds


def slowness() -> float:
    """Wall time of a small piece of work, over that on the machine of LEAST_TIME.

    2 on a machine of half the speed, or on one whose processors do something else half of the time.
    """
    import numpy as np

    numbers = np.fft.irfft2(np.random.default_rng(0).standard_normal((512, 257)))

    def seconds() -> float:
        began = time.perf_counter()
        for _ in range(8):
            np.sort(np.fft.irfft2(np.fft.rfft2(numbers)), axis=0)
        return time.perf_counter() - began

    slower = max(seconds(), seconds()) / _WORK
    return slower * _VARIES if slower > _VARIES else slower


def within_time(settings: CaptureSettings, photographs: int, slower: float) -> CaptureSettings:
    """Settings of a capture that keeps its time limit: the detail that fits into it.

    `photographs` are those of the sample, `slower` is the `slowness` of this machine.

    Raises:
        UsageError: the limit is shorter than the shortest capture.
    """
    if settings.time_limit is None:
        return settings
    longer = slower * (1.0 + _EACH * (photographs - 1))
    if settings.time_limit < LEAST_TIME * longer:
        least = values.spoken_duration(math.ceil(LEAST_TIME * longer))
        raise UsageError.at(
            "--time",
            f"the shortest capture takes about {least} on this machine as busy as it is now",
            f"give {least} or more, or --preset instant without --time",
        )
    if settings.detail is not None or settings.generator == "decoder":
        return settings
    limit = settings.time_limit / longer
    return replace(settings, detail=next(n for least, n in TIME_FOR_DETAIL if limit >= least))


# Progress of a capture: its stages, each with its share of the time.

# Processor seconds of stages, by report.json's stage_seconds of one photograph of 12 megapixels
# with the preset `standard`; of five photographs; and of a decoder that is fine-tuned alone.
_SECONDS = {
    "read": 0.3, "coarse fit": 2.0, "network": 0.7, "relief spectrum": 0.35, "refine": 0.8,
    "inpaint": 1.1, "index": 1.4, "verdict": 2.6, "write": 1.9,
    "statistics": 0.3, "start": 0.15, "fine-tuning": 3.6, "matching": 0.9, "choice": 0.6,
}  # fmt: skip
_OF_FIVE = {"register": 3.0, "network": 2.8, "align": 2.5, "solve": 7.5, "predict": 2.0}
_EXEMPLAR = ("network", "relief spectrum", "refine", "inpaint", "index")
_DECODER = ("statistics", "start", "fine-tuning", "matching")


def _shares(names: Sequence[str], others: Mapping[str, float] | None = None) -> Mapping[str, float]:
    """Share of each stage in the time of all, in order; `others` have other seconds."""
    seconds = _SECONDS | dict(others or {})
    whole = sum(seconds[name] for name in names)
    return MappingProxyType({name: seconds[name] / whole for name in names})


EXEMPLAR_STAGES = _shares(("read", "coarse fit", *_EXEMPLAR, "verdict", "write"))
# With a decoder beside the exemplar.
BOTH_STAGES = _shares(("read", "coarse fit", *_EXEMPLAR, "verdict", *_DECODER, "choice", "write"))
# Of several photographs of one sample.
_FITTED = ("coarse fit", "network", "relief spectrum", "refine", "align", "solve", "predict")
MULTIVIEW_STAGES = _shares(
    ("read", "register", *_FITTED, "inpaint", "index", "verdict", "write"), _OF_FIVE
)
# Of a decoder that reads a drawing, and of one that does not.
_ALONE = {"fine-tuning": 30.0}
DRAWING_STAGES = _shares(("read", "coarse fit", *_EXEMPLAR, *_DECODER, "verdict", "write"), _ALONE)
DECODER_STAGES = _shares(("read", "coarse fit", *_DECODER, "verdict", "write"), _ALONE)

# What is shown of a stage; several stages that a person need not tell apart have one name.
_ESTIMATING = "estimating maps"
SHOWN_STAGES: Mapping[str, str] = {
    "read": "reading",
    "register": "aligning the photographs",
    "coarse fit": "finding the highlight",
    **dict.fromkeys(
        ("network", "relief spectrum", "refine", "align", "solve", "predict"), _ESTIMATING
    ),
    "inpaint": "filling the highlight",
    "index": "preparing the texture",
    **dict.fromkeys(
        ("statistics", "start", "fine-tuning", "matching", "choice"), "training the decoder"
    ),
    "verdict": "checking",
    "write": "writing",
}


class RunStatus(Enum):
    """How a capture ended, or will end."""

    DONE = "done"
    INTERRUPTED = "interrupted"
    """By Ctrl-C, with the best result so far."""


@dataclass(frozen=True)
class CaptureProgress(Progress):
    """Progress of a capture."""

    error: float | None = None
    """Texture distance in fine-tuning a decoder, over that between neighbouring windows of the
    photograph; None in other stages."""
    status: RunStatus = RunStatus.DONE
    """INTERRUPTED after Ctrl-C: the remaining stages complete the best result so far."""


class CaptureClock:
    """Times the stages of a capture and reports progress to a callback.

    Attributes:
        seconds: duration of each completed stage.
        status: how the capture ended, or will end.
    """

    def __init__(
        self,
        on_progress: Callable[[CaptureProgress], None] | None,
        stages: Mapping[str, float] = EXEMPLAR_STAGES,
        limit: float | None = None,
        spent: float = 0.0,
    ) -> None:
        """Start the clock.

        Args:
            stages: names in order, each with its share of the time.
            limit: seconds for the whole command, or None.
            spent: seconds that the command has taken before.
        """
        self.seconds: dict[str, float] = {}
        self.status = RunStatus.DONE
        self._on_progress = on_progress or ignore_progress
        self._bounds, self._limit = _bounds(stages), limit
        self._spent = spent
        self._started = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._started

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a `with` block as a stage, and report its begin and end."""
        began = time.monotonic()
        self._on_progress(self._now(name, 0.0))
        try:
            yield
        except KeyboardInterrupt:
            self.status = RunStatus.INTERRUPTED
            raise
        finally:
            self.seconds[name] = time.monotonic() - began
        self._on_progress(self._now(name, 1.0))

    @contextmanager
    def completed(self, name: str) -> Iterator[None]:
        """A stage that Ctrl-C does not break off; it ends the capture early afterwards."""
        with self.stage(name), postponed() as stopped:
            yield
        if stopped():
            self.status = RunStatus.INTERRUPTED

    def within(self, name: str, share: float) -> None:
        """Report that a share, in [0, 1], of a stage is complete."""
        self._on_progress(self._now(name, share))

    def callback(self, name: str, begin: float = 0.0, end: float = 1.0) -> Callable[[float], None]:
        """Callback for the part of a stage from `begin` to `end`; it takes a share in [0, 1]."""
        return lambda share: self.within(name, begin + share * (end - begin))

    def tuning(self, share: float, error: float) -> None:
        """Report a step of fine-tuning, with its error (see CaptureProgress); NaN is none."""
        now = self._now("fine-tuning", share)
        self._on_progress(replace(now, error=error if error == error else None))

    def left_for(self, name: str) -> float:
        """Seconds left for a stage: limit - t - t * after / before, at least 0; infinite without.

        t is the time taken so far; `before` and `after` are the shares of earlier and later stages.
        """
        if self._limit is None:
            return float("inf")
        before, until_end = self._bounds[name]
        after = 1.0 - until_end
        until = self._spent + self.elapsed
        return max(0.0, self._limit - until - until * after / max(before, 1e-6))

    def _now(self, name: str, share: float) -> CaptureProgress:
        begin, end = self._bounds[name]
        fraction = min(end, begin + share * (end - begin))
        elapsed = self.elapsed
        left = elapsed * (1.0 - fraction) / fraction if fraction > 0.15 else None
        return CaptureProgress(name, fraction, elapsed, left, status=self.status)


def _bounds(stages: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """(begin, end) of every stage, as fractions of the whole time.

    Each stage begins at exactly the float at which the previous one ends, so that rounding never
    lowers the progress.
    """
    ends = [min(1.0, end) for end in accumulate(stages.values())]
    return dict(zip(stages, pairwise([0.0, *ends]), strict=True))
