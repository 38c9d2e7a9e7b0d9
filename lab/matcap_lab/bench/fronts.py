"""`matcap-lab bench fronts`: accuracy against time, by measures that no setting is tuned to.

Every configuration is a command line, every subject a material with known truth, photographed
like real ones (simulate/hand_held.py). The command runs in its own process; its output is
relit and compared with other true samples: normalised style distance by SqueezeNet, by patches and
by random filters (the last resemble the loss that decoders are tuned by).
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.inspection import inspect_file
from matcap.capture.settings import PRESETS, CaptureSettings
from matcap.errors import MatcapError
from matcap.example.example import Example
from matcap.field.material import Material
from matcap_lab.bench import relight
from matcap_lab.experiment import clocked
from matcap_lab.experiment.page import Presentation
from matcap_lab.experiment.results import Value, read
from matcap_lab.experiment.runner import Configuration, Experiment, choose
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap_lab.measures.nsd import SqueezeNetStyle
from matcap_lab.measures.style import Patches, RandomFilters, Style
from matcap_lab.simulate.hand_held import FORMS, PhonePhotographs
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import EXAMPLES, Specimen, subjects

BASE = "1024 texels"  # that others are paired with
# Map sets excluded from training (inverse/samples.py), of six kinds.
HELD_OUT = (
    "asphalt10",
    "bark_cgb_bark_01",
    "fabric_pattern_07",
    "ground041",
    "metal_t3_metal_tiles_003",
    "plastic004",
)
_LARGE = 4096  # pixels across: photographs that have the finest detail
_FINER = 2  # times as many texels, of the second look
_FINEST = 4  # likewise, of photographs of 12 megapixels
_NINE = ("granite", "leather", "plaster", "asphalt10")  # of which nine are taken; else five
# Enough for 1024 texels; shaded as finely as its pixels are, for five and nine cost a minute else.
_CAMERA = PhoneCamera(1200, 900, supersampling=1)
_INSPECTED = 1024  # texels
_CAPTURE = "from matcap.cli.start import run; run()"


@dataclass(frozen=True)
class Way:
    """A configuration of `matcap capture`."""

    group: str
    """The option varied."""

    options: tuple[str, ...] = ()
    """Options of `matcap capture`."""

    photographs: int = 1
    """Number of photographs of one sample."""

    pixels: int = _CAMERA.width
    """Width of the photographs."""

    form: str = "DNG"
    """Form of the files, of FORMS (simulate/hand_held.py)."""


_EXEMPLAR, _DECODER = ("--generator", "example", "--detail"), ("--generator", "decoder", "--steps")
WAYS: Mapping[str, Way] = {
    **{f"{n} texels": Way("one photograph", (*_EXEMPLAR, f"{n}")) for n in (256, 512, 1024)},
    "default": Way("default"),
    **{f"1024 texels, {form}": Way("files", (*_EXEMPLAR, "1024"), form=form) for form in FORMS[1:]},
    "default, JPEG": Way("default", form="JPEG"),
    **{
        f"{n} texels, {count} photographs": Way(
            "several", ("--detail", f"{n}", "--together"), count
        )
        for n in (512, 1024)
        for count in (2, 3, 5, 9)
    },
    **{f"decoder, {n} steps": Way("decoder", (*_DECODER, f"{n}")) for n in (0, 32, 112, 160)},
    **{
        f"12 megapixels, {n} texels": Way("detail", (*_EXEMPLAR, f"{n}"), pixels=_LARGE)
        for n in (512, 1024, 2048, 4096)
    },
}
# The default leaves out configurations that need large photographs.
USUAL = tuple(name for name, way in WAYS.items() if way.group != "detail")


def preset_ways() -> Mapping[str, str]:
    """Names of the presets by equivalent configuration, for the bench's photographs."""
    named = {"default": CaptureSettings().preset}
    for name in (name for name, effort in PRESETS.items() if not effort.decoder_steps):
        way = f"{CaptureSettings(preset=name).detail_of(_CAMERA.width)} texels"
        named[way] = f"{named[way]}, {name}" if way in named else name
    return named


PRESENTATION = Presentation(
    "Captures",
    "*Field*, *exemplar*: normalised style distance by SqueezeNet of the endless material and of "
    "the photographed rectangle, under lights away from the flash; 1 is indistinguishable from "
    "another sample. *Flash*: of the field under the photograph's own light; *fine*: of the field "
    "in pictures of 1024 pixels (2048 of large photographs), which show finer detail than the 512 "
    "of the others. *Patches*: by the sliced Wasserstein distance of patches of 3, 7 and 15 "
    "texels at three scales; *filters*: by random filters, statistics of the kind that decoders "
    "are fitted to. Seconds of the processor and memory are of the whole command, libraries "
    "included, on one thread; *clock*: wall time, meaningless while other programs ran. A "
    "configuration measured on fewer materials is given by its ratio to `draft` on the same "
    "ones; *over seeds*: standard deviation between seeds, its mean over materials.",
    ("seconds", "field"),
    BASE,
    ("1024 texels, 5 photographs",),
    preset_ways(),
    frozenset({"detail"}),
)


@dataclass(frozen=True)
class Fronts:
    """Subjects and configurations to measure."""

    out: Path
    """Folder of photographs, reports and the table."""

    sets: Path | None = None
    """Folder of map sets."""

    ways: Sequence[str] = USUAL
    """Names of configurations, keys of WAYS."""

    materials: Sequence[str] = ()
    """Named materials, kinds and map sets; by default the six named materials and, with a folder
    of sets, HELD_OUT."""

    seeds: Sequence[int] = (0,)
    """Seeds of the captures and of their fields."""

    settings: EvaluationSettings = field(default_factory=lambda: EvaluationSettings(camera=_CAMERA))
    """Sizes, lights, true samples and camera."""

    @property
    def chosen(self) -> tuple[str, ...]:
        """Names of the materials."""
        usual = (*EXAMPLES, *(HELD_OUT if self.sets else ()))
        return tuple(self.materials) or usual


@dataclass(frozen=True)
class FrontSubject:
    """Photographs of a material at one resolution, and true samples (evaluators)."""

    name: str
    paths: Mapping[str, Sequence[Path]]
    """Photographs of one sample, by form."""

    evaluator: Evaluator
    fine: Evaluator
    """Evaluator on finer texels."""

    seen: str
    """Warnings of `inspect` about the first photograph."""


@dataclass(frozen=True)
class CommandOutcome:
    """Output and cost of a command."""

    seed: int
    photographed: FrontSubject
    material: Material
    spent: Mapping[str, float]
    verdict: str

    @cached_property
    def endless(self) -> MapSet:
        """Field of the evaluator's size."""
        side = self.photographed.evaluator.side(self.material.texel_size)
        return self.material.maps(side, side, seed=self.seed)

    @cached_property
    def pictures(self) -> Tensor:
        """(L, 3, H, W) pictures of the field under the evaluator's lights."""
        own = self.material.setup.intensity
        return self.photographed.evaluator.relit(self.endless, own)


At = Callable[[int], FrontSubject]  # by pixels across


def fronts_experiment(bench: Fronts) -> Experiment[At, CommandOutcome]:
    """Every configuration on every material.

    Raises:
        UsageError: unknown configuration or material.
    """
    chosen = choose(WAYS, bench.ways)
    specimens = subjects(bench.chosen, bench.sets)
    counts = {specimen.name: 9 if specimen.name in _NINE else 5 for specimen in specimens}

    def prepare(specimen: Specimen) -> At:
        return cache(partial(_photographed, specimen, bench, counts[specimen.name]))

    return Experiment(
        "fronts",
        {specimen.name: partial(prepare, specimen) for specimen in specimens},
        {
            name: Configuration(partial(_capture, name, way, bench.out), way.group)
            for name, way in chosen.items()
        },
        (spent, errors, verdicts),
        bench.seeds,
        lambda subject, name: WAYS[name].photographs > counts[subject],
        any_version=True,
    )


def spent(_at: At, outcome: CommandOutcome) -> Mapping[str, Value]:
    """Processor time and wall time, s, and peak memory."""
    cost = outcome.spent
    return {
        "seconds": cost["processor"], "megabytes": cost["megabytes"], "clock": cost["clock"]
    }  # fmt: skip


def errors(_at: At, outcome: CommandOutcome) -> Mapping[str, Value]:
    """Normalised style distances of field and exemplar, by all measures."""
    evaluator, fine = outcome.photographed.evaluator, outcome.photographed.fine
    endless, own = outcome.endless, outcome.material.setup.intensity
    example, scene = outcome.material.part(Example), evaluator.own_scene
    exemplar = None if example is None else map_set_of(example.exemplar)
    return {
        "field": evaluator.style_ratio(outcome.pictures),
        "exemplar": math.nan if exemplar is None else evaluator.style_ratio_of(exemplar, own),
        "flash": evaluator.style_ratio(evaluator.relit(endless, own, scene), scene=scene),
        "fine": fine.style_ratio(fine.relit(endless, own)),
        "patches": evaluator.style_ratio(outcome.pictures, "patches"),
        "filters": evaluator.style_ratio(outcome.pictures, "filters"),
    }


def verdicts(_at: At, outcome: CommandOutcome) -> Mapping[str, Value]:
    """Verdict on the capture, and warnings of `inspect` about the photograph."""
    return {"verdict": outcome.verdict, "seen": outcome.photographed.seen}


def _photographed(specimen: Specimen, bench: Fronts, count: int, pixels: int) -> FrontSubject:
    """Photograph a material, and relight other samples of it."""
    usual = bench.settings.camera
    large = pixels == _LARGE
    phone = PhoneCamera(pixels, pixels * 3 // 4, supersampling=1) if large else usual
    taken = PhonePhotographs.of(specimen, phone)
    folder = bench.out / "photographs" / f"{specimen.name.replace(':', '-')}-{phone.width}"
    folder.mkdir(parents=True, exist_ok=True)
    paths, flash = taken.take(1 if large else count, folder)
    settings = replace(bench.settings, camera=taken.phone)
    styles: dict[str, Style] = {
        "squeezenet": SqueezeNetStyle(), "patches": Patches(), "filters": RandomFilters()
    }  # fmt: skip
    times = _FINEST if large else _FINER
    finer = replace(
        settings,
        detail=times * settings.detail,
        size=times * settings.size,
        finer=max(1, settings.finer // times),
    )
    evaluator = Evaluator(taken.specimen, flash, settings, styles)
    fine = Evaluator(taken.specimen, flash, finer, styles)
    return FrontSubject(specimen.name, paths, evaluator, fine, _inspected(paths["DNG"][0]))


def _inspected(photograph: Path) -> str:
    """Checks of `inspect` that are doubtful or failed for a photograph."""
    quality = inspect_file(photograph, _INSPECTED).quality
    remarks = [each.name for each in quality.findings if not each.rating.fit]
    return f"{quality.rating.value}{': ' if remarks else ''}{', '.join(remarks)}"


def _capture(name: str, way: Way, out: Path, at: At, seed: int) -> CommandOutcome:
    """Photograph the material, run a configuration's command and read its output."""
    photographed = at(way.pixels)
    with tempfile.TemporaryDirectory(dir=out) as folder:
        used = command_spent(command_of(name, photographed.paths[way.form], Path(folder), seed))
        path = next(Path(folder).rglob("*.matcap"), None)
        if path is None:
            raise MatcapError("the command wrote no material", remedy="run it to see why")
        material = Material.load(path)
        report = path.with_name("report.json")
        kept = out / "reports" / photographed.name.replace(":", "-")
        verdict = _reported(report, kept / f"{_kept_as(name, seed)}.json")
    return CommandOutcome(seed, photographed, material, used, verdict)


def command_of(name: str, photographs: Sequence[Path], folder: Path, seed: int) -> list[str]:
    """Command line of a configuration that writes into a folder."""
    way = WAYS[name]
    count = way.photographs if way.form == "DNG" else len(photographs)
    given = [str(path) for path in photographs[:count]]
    common = ["--quiet", "--seed", str(seed), "--out", str(folder)]
    return [sys.executable, "-c", _CAPTURE, "capture", *given, *way.options, *common]


def command_spent(command: Sequence[str]) -> dict[str, float]:
    """Cost of a command by clocked.py: `clock` and `processor`, s, and peak `megabytes`.

    Raises:
        MatcapError: it failed.
    """
    done = subprocess.run(
        [sys.executable, clocked.__file__, *command], capture_output=True, text=True, check=False
    )
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["nothing was said"]
        raise MatcapError(f"the command failed: {lines[-1]}", remedy="run it to see why")
    used: dict[str, float] = json.loads(done.stdout)
    return used


def _kept_as(name: str, seed: int) -> str:
    """File stem of a capture's report."""
    return name if seed == 0 else f"{name}, seed {seed}"


def _reported(report: Path, kept: Path) -> str:
    """First sentence of the report's verdict, empty without a report; copies it to `kept`."""
    if not report.exists():
        return ""
    text = report.read_text(encoding="utf-8")
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text(text, encoding="utf-8")
    verdict: dict[str, Any] = json.loads(text)["verdict"]
    return str(verdict["sentence"]).partition(". ")[0]


# Tables that `matcap-lab bench report` presents.
PRESENTATIONS: Mapping[str, Presentation] = {
    "fronts": PRESENTATION, "relight": relight.PLAN, "tolerances": relight.TOLERANCE
}  # fmt: skip


def presentation_of(table: Path) -> Presentation:
    """Presentation of the experiment that wrote a CSV.

    Raises:
        MatcapError: it is empty or missing, or its experiment is not part of the report.
    """
    rows = read(table)
    if not rows or rows[0].experiment not in PRESENTATIONS:
        what = f"bench {rows[0].experiment} is not reported" if rows else "no rows stand in it"
        remedy = f"give a CSV of {', '.join(PRESENTATIONS)}"
        raise MatcapError.at(table, what, remedy)
    return PRESENTATIONS[rows[0].experiment]
