"""`matcap bench quality`: how like the true material a capture looks under new lights.

For each procedural material one piece (seed a) is photographed, each method makes maps of it, and
the maps are relit and compared with other true pieces (seeds b, c, d) under the same lights, so
that nothing wins by pixel alignment. Errors are multiples of the *floor*: the error of true pieces
against each other.
"""

from __future__ import annotations

import csv
import io
import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import torch

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.files.picture import write_picture
from matcap.files.srgb import srgb_decode_tensor
from matcap.files.staging import staged
from matcap.flash.geometry import FlashSetup
from matcap.lab.bench.baselines import photo_as_albedo
from matcap.lab.bench.piece import photographed_piece, rearranged_piece
from matcap.lab.bench.relit import LIGHTS, BenchScene, bench_scene, relight_all
from matcap.lab.bench.style import PortillaSimoncelli, RandomFilters, Style, difference
from matcap.lab.simulate.examples import EXAMPLES, ExamplePhotograph, realisation
from matcap.lab.simulate.photograph import PhoneCamera, Shot, as_photo
from matcap.lab.simulate.specimen import named_specimen, photograph
from matcap.photo.photo import Photo

DECODER, ALBEDO = "decoder", "photo-as-albedo"
EXEMPLAR, BY_EXAMPLE = "exemplar", "by-example"
METHODS = (DECODER, EXEMPLAR, BY_EXAMPLE, ALBEDO)
_TRUTH_SEEDS = (1001, 1002, 1003)  # none of the examples'
_FINER = 2  # true radiance is averaged over this many texels a side: it has detail below a pixel


class Captured(Protocol):
    """What a method makes of a photograph."""

    @property
    def setup(self) -> FlashSetup:
        """Camera and flash, as the method found them."""
        ...

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        ...

    def maps(self, width: int, height: int, *, seed: int) -> MapSet:
        """One realisation."""
        ...


@dataclass(frozen=True)
class Subject:
    """A photograph with everything that is known of it.

    Attributes:
        example: material, seed and setup.
        path: its DNG: all that a capture may look at.
        photo: the same without a file.
        shot: the truth.
    """

    example: ExamplePhotograph
    path: Path
    photo: Photo
    shot: Shot


Capturing = Callable[[Subject], Captured]


@dataclass(frozen=True)
class QualitySettings:
    """What is compared.

    Attributes:
        detail: texels along the photograph's long side, of prediction and truth.
        size: texels a side of the pictures compared.
        camera: that takes the photographs.
    """

    detail: int = 1024
    size: int = 384
    camera: PhoneCamera = field(default_factory=PhoneCamera)


@dataclass(frozen=True)
class Score:
    """One method on one material.

    Attributes:
        material, method: which.
        portilla_simoncelli, random_filters: errors as multiples of the floor.
        seconds: that the method took.
    """

    material: str
    method: str
    portilla_simoncelli: float
    random_filters: float
    seconds: float

    @property
    def mean(self) -> float:
        """Of both statistics."""
        return (self.portilla_simoncelli + self.random_filters) / 2.0


class Yardstick:
    """True pieces of a material, relit and described: what predictions are held against."""

    def __init__(
        self,
        material: str,
        flash: FlashSetup,
        settings: QualitySettings,
        styles: Sequence[Style],
    ) -> None:
        """Relight the true pieces under the bench's lights.

        Args:
            material: a name in MATERIALS.
            flash: the true setup of the photograph.
            settings: sizes.
            styles: kinds of statistics.
        """
        self.scene = bench_scene(flash)
        self._styles = tuple(styles)
        camera = settings.camera
        pixels, texel = settings.size * _FINER, 2.0 / (settings.detail * _FINER)
        self.pictures = [
            relight_all(
                realisation(material, seed)(pixels, pixels, texel),
                flash.intensity,
                self.scene,
                size=(settings.size, settings.size),
                blur=camera.blur * settings.detail * _FINER / camera.width,
            )
            for seed in _TRUTH_SEEDS
        ]
        self._truths = [[style(picture) for picture in self.pictures] for style in self._styles]
        self.floors = [
            _mean(difference(a, b) for a, b in itertools.combinations(truths, 2))
            for truths in self._truths
        ]

    def measure(self, pictures: torch.Tensor) -> list[float]:
        """Error of pictures (L, 3, H, W) under the lights, in floors, one for each style."""
        return [
            _mean(difference(style(pictures), truth) for truth in truths) / floor
            for style, truths, floor in zip(self._styles, self._truths, self.floors, strict=True)
        ]


def run_quality(
    capture: Callable[[Path], Captured],
    out: Path,
    *,
    materials: Iterable[str] = tuple(EXAMPLES),
    methods: Iterable[str] = METHODS,
    settings: QualitySettings | None = None,
    tell: Callable[[str], None] = lambda _line: None,
) -> list[Score]:
    """Photograph, capture, relight and compare; photographs and pictures go to `out`.

    Args:
        capture: path of a DNG to an object with maps(width, height, seed=...), setup (its own
            estimate of camera and flash) and texel_size 2 / detail.
        out: folder for the photographs (DNG) and for the relit pictures side by side (PNG).
        materials: names in EXAMPLES.
        methods: names in METHODS.
        settings: what is compared.
        tell: called with a line for each score.

    Returns:
        A score for each material and method.

    Raises:
        UsageError: no such material or method, or maps of another detail.
        MatcapError: a capture failed, plenoptic is missing, `out` cannot be written.
    """
    settings = settings or QualitySettings()
    chosen = _methods(capture, settings)
    materials, methods = list(materials), list(methods)
    for name, known in [(m, EXAMPLES) for m in materials] + [(m, chosen) for m in methods]:
        if name not in known:
            raise UsageError("there is none of this name", where=name, remedy=_among(known))
    styles: list[Style] = [PortillaSimoncelli((settings.size, settings.size)), RandomFilters()]
    scores = []
    for material in materials:
        subject = _photograph(EXAMPLES[material], out, settings.camera)
        yardstick = Yardstick(material, subject.shot.setup, settings, styles)
        columns = {"truth": yardstick.pictures[0]}
        for method in methods:
            began = time.perf_counter()
            captured = chosen[method](subject)
            seconds = time.perf_counter() - began
            pictures = _relit(captured, settings, yardstick.scene)
            grey, filters = yardstick.measure(pictures)
            score = Score(material, method, grey, filters, seconds)
            tell(f"{material:8} {method:16} {score.mean:5.2f} floors, {seconds:.0f} s")
            columns[method] = pictures
            scores.append(score)
        _write_sheet(out / f"{material}.png", columns)
    return scores


def markdown(scores: Sequence[Score], command: str) -> str:
    """The scores as a section of documentation."""
    lines = [
        "# Quality: style error under new lights",
        "",
        "Measured by:",
        "",
        f"    {command}",
        "",
        f"Error of the relit result against other true pieces of the same material, mean over "
        f"{LIGHTS} point lights away from the flash, as multiples of the floor (the error of true "
        "pieces against each other; 1 is indistinguishable). PS: Portilla-Simoncelli statistics; "
        "RF: random filters unknown to capture; both are defined in matcap/lab/bench/style.py.",
        "",
        "| material | method | PS | RF | mean | seconds |",
        "|---|---|---:|---:|---:|---:|",
    ]
    for score in [*scores, *_averages(scores)]:
        lines.append(
            f"| {score.material} | {score.method} | {score.portilla_simoncelli:.2f} | "
            f"{score.random_filters:.2f} | {score.mean:.2f} | {score.seconds:.0f} |"
        )
    return "\n".join(lines) + "\n"


def comma_separated(scores: Sequence[Score]) -> str:
    """The scores as CSV."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        ["material", "method", "portilla_simoncelli", "random_filters", "mean", "seconds"]
    )
    for score in scores:
        numbers = (score.portilla_simoncelli, score.random_filters, score.mean, score.seconds)
        writer.writerow([score.material, score.method, *(f"{number:.4f}" for number in numbers)])
    return stream.getvalue()


def write_scores(scores: Sequence[Score], out: Path, command: str) -> None:
    """Write quality.md and quality.csv into a folder.

    Raises:
        MatcapError: the folder cannot be written.
    """
    with staged(out) as stage:
        (stage / "quality.md").write_text(markdown(scores, command))
        (stage / "quality.csv").write_text(comma_separated(scores))


def _methods(
    capture: Callable[[Path], Captured], settings: QualitySettings
) -> Mapping[str, Capturing]:
    def captured(subject: Subject) -> Captured:
        return capture(subject.path)

    def albedo(subject: Subject) -> Captured:
        return photo_as_albedo(subject.photo, subject.shot.setup, settings.detail)

    def piece(subject: Subject) -> Captured:
        return photographed_piece(subject.path, settings.detail)

    def rearranged(subject: Subject) -> Captured:
        return rearranged_piece(subject.path, settings.detail)

    return {
        DECODER: captured,
        EXEMPLAR: piece,
        BY_EXAMPLE: rearranged,
        ALBEDO: albedo,
    }


def _photograph(example: ExamplePhotograph, out: Path, camera: PhoneCamera) -> Subject:
    path, shot = photograph(named_specimen(example.material), camera, out)
    return Subject(example, path, as_photo(shot, example.seed, path.name), shot)


def _relit(captured: Captured, settings: QualitySettings, scene: BenchScene) -> torch.Tensor:
    expected = 2.0 / settings.detail
    if abs(captured.texel_size / expected - 1.0) > 1e-3:
        raise UsageError(
            f"the maps have texels of {captured.texel_size:.6g} plane units, not {expected:.6g}",
            remedy=f"capture with a detail of {settings.detail}",
        )
    maps = captured.maps(settings.size, settings.size, seed=0)
    return relight_all(maps.map(lambda m: m.detach().float()), captured.setup.intensity, scene)


def _write_sheet(path: Path, columns: Mapping[str, torch.Tensor]) -> None:
    """Every third light a row, truth first, then each method."""
    rows = [torch.cat(list(row), dim=2) for row in zip(*columns.values(), strict=True)]
    sheet = torch.cat(rows[::3], dim=1)
    linear = srgb_decode_tensor(sheet)
    write_picture(linear.permute(1, 2, 0).contiguous().numpy(), path)


def _averages(scores: Sequence[Score]) -> list[Score]:
    averages = []
    for method in dict.fromkeys(score.method for score in scores):
        of = [score for score in scores if score.method == method]
        averages.append(
            Score(
                "mean",
                method,
                sum(score.portilla_simoncelli for score in of) / len(of),
                sum(score.random_filters for score in of) / len(of),
                sum(score.seconds for score in of) / len(of),
            )
        )
    return averages


def _mean(values: Iterable[torch.Tensor]) -> float:
    """Over pairs and lights."""
    return float(torch.stack(list(values)).mean())


def _among(known: Iterable[str]) -> str:
    return f"choose from {', '.join(known)}"
