"""`matcap bench capture`: what accuracy costs in time, for captures.

Every point is a way of capturing (a preset, a number of steps, a window size, ...), every subject
a simulated photograph whose truth is known. A capture runs in a process of its own, so that its
time and its memory are its own; its material is then relit and compared, as in quality.py. Errors
are multiples of the floor; diversity is how far two realisations are apart, pixel by pixel, as a
share of what two true pieces are.

Resumable: a measurement is a line of a CSV, appended when made; what is there is skipped.
"""

from __future__ import annotations

import math
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch

from matcap.capture.settings import FEATURES, PRESETS, CaptureSettings, Method
from matcap.errors import UsageError
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.flash.geometry import FlashSetup
from matcap.lab.bench.quality import QualitySettings, Yardstick
from matcap.lab.bench.relit import BenchLight, BenchScene, relight_all
from matcap.lab.bench.style import PortillaSimoncelli, RandomFilters, Style
from matcap.lab.bench.table import Measurement, append, machine, read
from matcap.lab.simulate.examples import EXAMPLES
from matcap.lab.simulate.materials import random_material
from matcap.lab.simulate.photograph import Realise
from matcap.lab.simulate.specimen import Specimen, named_specimen, photograph
from matcap.space.decoder import PAPER_CONFIG, DecoderConfig
from matcap.space.patch import Patch
from matcap.statistics.filterbank import FilterBankConfig

_BASE_STEPS, _BASE_PLACES = 160, 2  # of every point that does not vary them
_PAPER_STEPS = 1000
_PAPER, _PAPER_FORM = "paper", "paper's form"


@dataclass(frozen=True)
class Way:
    """A way of capturing.

    Attributes:
        group: what it varies.
        settings, method: as capture_photo takes them; the detail is the sweep's unless it is this
            way's own.
        detail: texels along the long side, or None for the sweep's.
    """

    group: str
    settings: CaptureSettings
    method: Method = Method()
    detail: int | None = None


def _tuned(**changed: Any) -> CaptureSettings:  # noqa: ANN401
    """Read by the decoder, whose tuning most of the sweep is about."""
    return CaptureSettings(**{"generator": "decoder", **changed})


def _base(**changed: Any) -> CaptureSettings:  # noqa: ANN401
    return _tuned(**{"steps": _BASE_STEPS, **changed})


def _method(**changed: Any) -> Method:  # noqa: ANN401
    return Method(**{"places": _BASE_PLACES, **changed})


def _ways() -> dict[str, Way]:
    ways = {f"{name}": Way("preset", CaptureSettings(preset=name)) for name in PRESETS}
    ways |= {f"decoder, {name}": Way("decoder", _tuned(preset=name)) for name in PRESETS}
    for adapted in (0, 40, 160):
        ways[f"adapted {adapted}"] = Way("adaptation", CaptureSettings(), Method(adapted=adapted))
    for steps in (10, 20, 60, 80, 120, _BASE_STEPS, 200, 400):
        ways[f"{steps} steps"] = Way("steps", _base(steps=steps), _method())
    for seconds in (2.0, 5.0, 10.0, 20.0, 40.0):
        ways[f"{seconds:.0f} s"] = Way("time", _tuned(time_limit=seconds))
    for window in (96, 128, 192, 256):
        ways[f"window {window}"] = Way("window", _base(), _method(window=window))
    for places in (1, 4):  # three are the preset `standard`
        ways[f"windows a step: {places}"] = Way("windows", _base(), _method(places=places))
    for name, bank in (
        ("small filter bank", replace(FEATURES, filters=24)),
        ("large filter bank", replace(FEATURES, sizes=(3, 5, 9), filters=48)),
        ("levels apart", replace(FEATURES, crossed=False)),
    ):
        ways[name] = Way("statistics", _base(), _method(features=bank))
    ways["not matched"] = Way("matching", _base(), _method(matched=False))
    ways["float32"] = Way("precision", _base(), _method(half_precision=False))
    ways["no prior"] = Way("prior", _base(prior="none"), _method())
    ways["no prior, 640 steps"] = Way("prior", _base(prior="none", steps=640), _method())
    for name, widths in (("narrow", (8, 16, 32, 32, 32)), ("wide", (32, 64, 128, 128, 128))):
        wide = _method(decoder=DecoderConfig(widths=widths))
        ways[f"no prior, {name}"] = Way("width", _base(prior="none"), wide)
    for detail in (512, 768):
        ways[f"detail {detail}"] = Way("detail", _base(), _method(), detail=detail)
    # The paper's decoder and number of steps, on as much of its 512 x 384 as a square window holds.
    paper = Method(
        window=384,
        features=FilterBankConfig(sizes=(3, 5, 9), filters=48, crossed=False),
        decoder=PAPER_CONFIG,
        half_precision=False,
        places=1,
        matched=False,
    )
    ways[_PAPER_FORM] = Way(_PAPER, _base(prior="none", steps=_PAPER_STEPS), paper, 512)
    for name in ("standard", "reference"):
        beside = f"{name} beside it"
        ways[beside] = Way(_PAPER, CaptureSettings(preset=name), detail=512)
        ways[f"decoder, {beside}"] = Way(_PAPER, _tuned(preset=name), detail=512)
    return ways


WAYS: Mapping[str, Way] = MappingProxyType(_ways())
# What a sweep without a choice measures: all but the paper's form, which takes an hour a subject,
# and what is held against it at its detail.
USUAL = tuple(name for name, way in WAYS.items() if way.group != _PAPER)


@dataclass(frozen=True)
class CaptureBench:
    """What is measured.

    Attributes:
        out: folder of photographs, materials and the table, capture.csv.
        ways: names in WAYS.
        subjects: names in SUBJECTS; the named materials and two of the stream where there is none.
        seeds: of the captures.
        quality: sizes of what is compared; its detail is the sweep's.
        steps: instead of every way's own, to try the sweep out; or None.
    """

    out: Path
    ways: Sequence[str] = USUAL
    subjects: Sequence[str] = ()
    seeds: Sequence[int] = (0,)
    quality: QualitySettings = field(default_factory=QualitySettings)
    steps: int | None = None

    @property
    def table(self) -> Path:
        """Where the measurements go."""
        return self.out / "capture.csv"


def _specimens() -> dict[str, Specimen]:
    known = {name: named_specimen(name) for name in EXAMPLES}
    # Beside the named ones, some of the stream the prior never trains on by these seeds; and those
    # of them whose patterns the inverse network never trains on either (inverse/samples.py).
    streams = {
        "varied": (90001, 90002, 90003, 90004),
        "held-out": (90005, 90007, 90008, 90009, 90011, 90013, 90017, 90018),
    }
    for stream, seeds in streams.items():
        for index, seed in enumerate(seeds):
            setup = FlashSetup(offset=(0.1, -0.05, 0.0), tilt=(0.02 * (index % 4), -0.03))
            name = f"{stream}-{index + 1}"
            known[name] = Specimen(name, partial(_varied, seed), 21, setup)
    return known


def _varied(material: int, seed: int) -> Realise:
    drawn = random_material(np.random.default_rng(material))
    return partial(_realised, drawn, seed)


def _realised(drawn: Any, seed: int, width: int, height: int, texel: float) -> Any:  # noqa: ANN401
    return drawn.realise(width, height, seed, texel)


SUBJECTS: Mapping[str, Specimen] = MappingProxyType(_specimens())
USUAL_SUBJECTS = (*EXAMPLES, "varied-1", "varied-2")


def run_capture_bench(
    bench: CaptureBench, tell: Callable[[str], None] = lambda _line: None
) -> list[Measurement]:
    """Measure whatever is not in the table yet; gives the whole table.

    Raises:
        UsageError: no such way or subject.
        MatcapError: plenoptic is missing, `out` cannot be written.
    """
    subjects = list(bench.subjects or USUAL_SUBJECTS)
    _check(bench.ways, WAYS)
    _check(subjects, SUBJECTS)
    done = {one.key for one in read(bench.table)}
    for subject in subjects:
        todo = [
            (way, seed)
            for way in bench.ways
            for seed in bench.seeds
            if ("capture", way, subject, seed) not in done
        ]
        if not todo:
            continue
        path, shot = photograph(SUBJECTS[subject], bench.quality.camera, bench.out)
        judges = cache(partial(_Judge, subject, shot.setup, bench.quality))
        for name, seed in todo:
            way = WAYS[name]
            detail = way.detail or bench.quality.detail
            settings = replace(way.settings, detail=detail, seed=seed)
            if bench.steps is not None:
                settings = replace(settings, steps=bench.steps)
            material = bench.out / f"{subject}, {name}{f', seed {seed}' * (seed > 0)}.matcap"
            seconds, megabytes = _in_own_process(path, settings, way.method, material)
            error, flash, diversity = judges(detail).judge(Material.load(material))
            measured = Measurement(
                "capture", way.group, name, subject, seconds, megabytes, error, flash, diversity,
                machine(), seed,
            )  # fmt: skip
            append(bench.table, measured)
            tell(f"{subject:10} {name:24} {error:6.2f} floors {seconds:7.1f} s {megabytes:6.0f} MB")
    return read(bench.table)


class _Judge:
    """True pieces of a subject, to hold captures of one detail against."""

    def __init__(
        self, subject: str, flash: FlashSetup, quality: QualitySettings, detail: int
    ) -> None:
        self._quality = replace(
            quality, detail=detail, size=quality.size * detail // quality.detail
        )
        size = self._quality.size
        styles: list[Style] = [PortillaSimoncelli((size, size)), RandomFilters()]
        specimen = SUBJECTS[subject]
        make = partial(Yardstick, subject, flash, self._quality, styles, pieces=specimen.pieces)
        self._relit = make()
        x, y, z = flash.offset
        own = BenchLight((x, y, z + flash.distance), 1.0)
        self._flash = make(scene=BenchScene(flash.distance, (own,)))

    def judge(self, material: Material) -> tuple[float, float, float]:
        """Errors under the bench's lights and under the photograph's, in floors; diversity."""
        size = self._quality.size
        errors, pieces = [], []
        for yardstick in (self._relit, self._flash):
            relit = [
                relight_all(
                    material.maps(size, size, seed=seed), material.setup.intensity, yardstick.scene
                )
                for seed in (0, 1)
            ]
            scores = yardstick.measure(relit[0])
            errors.append(sum(scores) / len(scores))
            pieces.append(relit)
        first, second = pieces[0]
        true, other = self._relit.pictures[:2]
        apart = float((first - second).abs().mean() / (true - other).abs().mean())
        return errors[0], errors[1], apart


def _in_own_process(
    photo: Path, settings: CaptureSettings, method: Method, material: Path
) -> tuple[float, float]:
    """Capture a file; gives seconds of processor time from opening it to the material, and the
    most megabytes.
    """
    context = multiprocessing.get_context("spawn")
    with context.Pool(1) as pool:
        return pool.apply(_capture, (photo, settings, method, material))


def _capture(
    photo: Path, settings: CaptureSettings, method: Method, material: Path
) -> tuple[float, float]:
    from matcap.capture.pipeline import capture_photo, read_photograph

    began = time.process_time()  # other work on the machine does not count
    read_in = read_photograph(photo, settings)
    capture_photo(read_in, settings, method=method).material.save(material)
    seconds = time.process_time() - began
    return seconds, megabytes_held()


def megabytes_held() -> float:
    """The most memory this process has held, in megabytes, libraries included."""
    try:
        # Not getrusage, which on Linux starts from what the parent held.
        for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1e3
    except OSError:
        pass  # not Linux
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def step_seconds(way: str, *, steps: int = 3) -> tuple[float, float]:
    """Seconds of one step of fine-tuning in the paper's picture size, and megabytes; see `WAYS`.

    512 x 384 texels of random photograph, the decoder and the features of a way; forward,
    backward and the optimiser's step. The least of `steps` after one to warm up.
    """
    from matcap.brdf.maps import MapSet
    from matcap.flash.geometry import plane_points
    from matcap.flash.render import render_flash
    from matcap.space.decoder import CODE_SIZE, DEPTH, Decoder, maps_from_raw
    from matcap.space.random_field import random_field
    from matcap.statistics.compare import Weights, describe, distance
    from matcap.statistics.encoding import fit_encoding
    from matcap.statistics.filterbank import FilterBank
    from matcap.statistics.precision import computes_bfloat16

    width, height, method = 512, 384, WAYS[way].method
    half = method.half_precision and computes_bfloat16()
    generator = torch.Generator().manual_seed(0)
    photo = torch.rand(3, height, width, generator=generator)
    encoding = fit_encoding(photo, torch.ones(height, width, dtype=torch.bool))
    bank = FilterBank(method.features)
    target = describe(photo[None], encoding, bank)
    shape = method.decoder or DecoderConfig()
    decoder = Decoder(shape)
    optimiser = torch.optim.Adam(decoder.parameters(), fused=True)
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)[None]
    code, setup = torch.zeros(CODE_SIZE), FlashSetup(intensity=(10.0,) * 3)
    least = math.inf
    for seed in range(steps + 1):
        began = time.perf_counter()
        channels = shape.noise_channels
        noise = random_field(
            Patch(seed, Rectangle(0, 0, width, height), period=(width, height)),
            channels,
            (),
            levels=DEPTH,
        )
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            raw = decoder(noise, code)
        maps: MapSet = maps_from_raw(raw, 2.0 / width, periodic=True)
        rendered = render_flash(maps, setup, points)
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            found = describe(rendered, encoding, bank)
        optimiser.zero_grad(set_to_none=True)
        distance(found, target, Weights()).mean().backward()
        optimiser.step()
        if seed:
            least = min(least, time.perf_counter() - began)
    return least, megabytes_held()


def run_steps(
    bench: CaptureBench, tell: Callable[[str], None] = lambda _line: None
) -> list[Measurement]:
    """Add the cost of one step in today's form and in the paper's to the table; gives the table."""
    context = multiprocessing.get_context("spawn")
    for way in ("standard", _PAPER_FORM):
        with context.Pool(1) as pool:
            seconds, megabytes = pool.apply(step_seconds, (way,))
        append(
            bench.table,
            Measurement(
                "step", "form", way, "512 x 384", seconds, megabytes, math.nan, machine=machine()
            ),
        )
        tell(f"{way:24} {seconds:7.3f} s a step {megabytes:6.0f} MB")
    return read(bench.table)


def _check(names: Iterable[str], known: Iterable[str]) -> None:
    for name in names:
        if name not in known:
            raise UsageError(
                "there is none of this name", where=name, remedy=f"choose from {', '.join(known)}"
            )
