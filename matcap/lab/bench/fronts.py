"""`matcap bench fronts`: what accuracy costs, told by measures that nothing is tuned by.

Every point is a command line (ways.py), every subject a material whose truth is known, photographed
as real ones are (held.py). The command runs as a user runs it; what it wrote is relit and compared
with other true pieces, in floors, by SqueezeNet first (floors/distance.py), by patches
(floors/patches.py) and by random filters, as decoders are tuned by (style.py).

Resumable: a measurement is a line of a CSV, appended when made; what is there is skipped.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.inspection import inspect_file
from matcap.capture.piece.find import piece_maps
from matcap.errors import MatcapError, UsageError
from matcap.example.example import Example
from matcap.field.material import Material
from matcap.files.picture import write_picture
from matcap.files.srgb import srgb_decode_tensor
from matcap.flash.geometry import FlashSetup
from matcap.lab.bench import clocked
from matcap.lab.bench.held import Held
from matcap.lab.bench.relit import BenchLight, BenchScene
from matcap.lab.bench.style import RandomFilters, Style
from matcap.lab.bench.table import Measurement, append, machine, read
from matcap.lab.bench.ways import PAPER, USUAL, WAYS, Way
from matcap.lab.floors.distance import Floor, Measure
from matcap.lab.floors.patches import Patches
from matcap.lab.floors.run import FloorSettings, Judge, middle_of, side_of
from matcap.lab.floors.subjects import subjects
from matcap.lab.simulate.examples import EXAMPLES
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.specimen import Specimen

# Map sets that no training has seen (inverse/packed.py), of six kinds.
HELD_OUT = (
    "asphalt10",
    "bark_cgb_bark_01",
    "fabric_pattern_07",
    "ground041",
    "metal_t3_metal_tiles_003",
    "plastic004",
)
_FINER = 2  # times as many texels, of the second look
_FINEST = 4  # likewise, of photographs of 12 megapixels
_NINE = ("granite", "leather", "plaster", "asphalt10")  # of which nine are taken; else five
_MEASURES = ("error", "patches", "filters")
# Enough for 1024 texels; shaded as finely as its pixels are, for five and nine cost a minute else.
_CAMERA = PhoneCamera(1200, 900, supersampling=1)
_SHOWN = (1, 3)  # of the lights, on sheets
_INSPECTED = 1024  # texels
_CAPTURE = "from matcap.cli.start import run; run()"
_PAPER = "import sys; from matcap.lab.bench.paper import main; main(sys.argv[1:])"


@dataclass(frozen=True)
class Fronts:
    """What is measured.

    Attributes:
        out: folder of photographs, sheets and the table, fronts.csv.
        sets: folder of map sets, or None.
        points: names in WAYS.
        materials: named ones, kinds and map sets; by default the six named ones and, with a
            folder of sets, HELD_OUT.
        seeds: of the captures and of what is drawn of them.
        settings: sizes of what is compared, and the camera.
    """

    out: Path
    sets: Path | None = None
    points: Sequence[str] = USUAL
    materials: Sequence[str] = ()
    seeds: Sequence[int] = (0,)
    settings: FloorSettings = field(default_factory=lambda: FloorSettings(camera=_CAMERA))

    @property
    def table(self) -> Path:
        """Where the measurements go."""
        return self.out / "fronts.csv"

    @property
    def chosen(self) -> tuple[str, ...]:
        """Names of the materials."""
        usual = (*EXAMPLES, *(HELD_OUT if self.sets else ()))
        return tuple(self.materials) or usual


def run_fronts(
    bench: Fronts, tell: Callable[[str], None] = lambda _line: None
) -> list[Measurement]:
    """Measure whatever is not in the table yet; gives the whole table.

    What cannot be captured is told, and is no line.

    Raises:
        UsageError: no such point or material.
        MatcapError: `out` cannot be written.
    """
    for name in bench.points:
        if name not in WAYS:
            known = ", ".join(WAYS)
            raise UsageError("there is no such point", where=name, remedy=f"choose from {known}")
    done = {one.key for one in read(bench.table)}
    specimens = {one.name: one for one in subjects(bench.chosen, bench.sets)}
    for seed in bench.seeds:
        for subject, specimen in specimens.items():
            todo = [
                point
                for point in bench.points
                if ("capture", point, subject, seed) not in done and _suits(point, subject)
            ]
            yards: dict[int, _Yard] = {}
            for point in todo:
                pixels = WAYS[point].pixels or bench.settings.camera.width
                if pixels not in yards:
                    yards[pixels] = _Yard.of(specimen, pixels, bench)
                try:
                    measured = _measured(yards[pixels], bench, point, seed)
                except MatcapError as error:
                    tell(f"{subject}, {point}: {error}")
                    continue
                append(bench.table, measured)
                tell(
                    f"{subject:24} {point:22} {seed} {measured.error:5.2f} floors, piece "
                    f"{measured.piece:5.2f} {measured.seconds:6.1f} s {measured.megabytes:5.0f} MB"
                )
    return read(bench.table)


def _suits(point: str, subject: str) -> bool:
    return WAYS[point].photographs <= _taken(subject)


def _taken(subject: str) -> int:
    return 9 if subject in _NINE else 5


@dataclass(frozen=True)
class _Yard:
    """A material's photographs, and the true pieces that captures are held against.

    Attributes:
        name: of the material.
        photographs: of one piece.
        judge, fine: relight as truths are, on the usual texels and on finer ones.
        scenes: the bench's lights, and the photograph's own.
        floors: by measure, of each scene.
        seen: what `inspect` says of the first photograph.
        settings: sizes.
    """

    name: str
    photographs: Sequence[Path]
    judge: Judge
    fine: Judge
    scenes: tuple[BenchScene, BenchScene]
    floors: Mapping[str, tuple[_Floors, _Floors]]
    seen: str
    settings: FloorSettings

    @staticmethod
    def of(specimen: Specimen, pixels: int, bench: Fronts) -> _Yard:
        """Photograph a material, and relight other pieces of it."""
        usual = bench.settings.camera
        large = pixels != usual.width
        phone = PhoneCamera(pixels, pixels * 3 // 4, supersampling=1) if large else usual
        held = Held.of(specimen, phone)
        folder = bench.out / "photographs" / f"{specimen.name.replace(':', '-')}-{pixels}"
        folder.mkdir(parents=True, exist_ok=True)
        count = 1 if large else _taken(specimen.name)
        photographs, flash = held.photographs(count, folder)
        settings = replace(bench.settings, camera=held.phone)
        measure = Measure()
        judge = Judge(held.specimen, flash, settings, measure)
        times = _FINEST if large else _FINER
        finer = replace(
            settings,
            detail=times * settings.detail,
            size=times * settings.size,
            finer=max(1, settings.finer // times),
        )
        fine = Judge(held.specimen, flash, finer, measure)
        scenes = (judge.scene, _own_scene(flash))
        true = [judge.pictures, judge.relit_truths(scenes[1])]
        styles: dict[str, Style] = dict(
            zip(_MEASURES, (measure.style, Patches().style, RandomFilters()), strict=True)
        )
        floors = {
            name: (_Floors(style, true[0]), _Floors(style, true[1]))
            for name, style in styles.items()
        }
        _write_sheet(bench.out, specimen.name, "truth", true[0][0])
        seen = _inspected(photographs[0])
        return _Yard(specimen.name, photographs, judge, fine, scenes, floors, seen, settings)


class _Floors:
    """True pieces under one scene, by one measure."""

    def __init__(self, style: Style, pictures: Iterable[Tensor]) -> None:
        self._style, self._floor = style, Floor([style(each) for each in pictures])

    def of(self, found: Tensor) -> float:
        return self._floor.of(self._style(found))


def _own_scene(flash: FlashSetup) -> BenchScene:
    x, y, z = flash.offset
    return BenchScene(flash.distance, (BenchLight((x, y, z + flash.distance), 1.0),))


def _inspected(photograph: Path) -> str:
    """What `inspect` says of it that is not good."""
    quality = inspect_file(photograph, _INSPECTED).quality
    told = [each.name for each in quality.findings if each.verdict.value not in ("good", "note")]
    return f"{quality.verdict.value}{': ' if told else ''}{', '.join(told)}"


def _measured(yard: _Yard, bench: Fronts, point: str, seed: int) -> Measurement:
    """Capture by a way, and judge."""
    way, settings = WAYS[point], yard.settings
    with tempfile.TemporaryDirectory(dir=bench.out) as folder:
        spent = _spent(_command(point, way, yard.photographs, Path(folder), seed))
        path = next(Path(folder).rglob("*.matcap"), None)
        if path is None:
            raise MatcapError("the command wrote no material", remedy="run it to see why")
        material = Material.load(path)
        told = _reported(path.with_name("report.json"), yard.name, point, seed, bench.out)
    side = side_of(material.texel_size, settings)
    endless, own = material.maps(side, side, seed=seed), material.setup.intensity
    pictures = yard.judge.relit(endless, own)
    errors = {name: floors[0].of(pictures) for name, floors in yard.floors.items()}
    example = material.part(Example)
    piece = math.nan if example is None else yard.floors["error"][0].of(_piece(yard, example, own))
    _write_sheet(bench.out, yard.name, kept_as(point, seed), pictures)
    return Measurement(
        "capture", way.group, point, yard.name, spent["processor"], spent["megabytes"],
        **errors, piece=piece,
        flash=yard.floors["error"][1].of(yard.judge.relit(endless, own, yard.scenes[1])),
        fine=yard.fine.floors(endless, own),
        clock=spent["clock"], machine=machine(), seed=seed, verdict=told, seen=yard.seen,
    )  # fmt: skip


def _piece(yard: _Yard, example: Example, own: tuple[float, float, float]) -> Tensor:
    """The piece that was found, relit."""
    maps: MapSet = piece_maps(example.exemplar)
    return yard.judge.relit(middle_of(maps, side_of(maps.texel_size, yard.settings)), own)


def _command(
    point: str, way: Way, photographs: Sequence[Path], folder: Path, seed: int
) -> list[str]:
    first = str(photographs[0])
    if point == PAPER:
        return [sys.executable, "-c", _PAPER, first, str(folder / "paper.matcap"), str(seed)]
    given = [str(path) for path in photographs[: way.photographs]]
    told = ["--quiet", "--seed", str(seed), "--out", str(folder)]
    return [sys.executable, "-c", _CAPTURE, "capture", *given, *way.options, *told]


def _spent(command: Sequence[str]) -> dict[str, float]:
    """What a command took, by clocked.py."""
    done = subprocess.run(
        [sys.executable, clocked.__file__, *command], capture_output=True, text=True, check=False
    )
    if done.returncode:
        told = done.stderr.strip().splitlines() or ["nothing was said"]
        raise MatcapError(f"the command failed: {told[-1]}", remedy="run it to see why")
    spent: dict[str, float] = json.loads(done.stdout)
    return spent


def kept_as(point: str, seed: int) -> str:
    """What a capture's sheet and report are called."""
    return point if seed == 0 else f"{point}, seed {seed}"


def _reported(report: Path, subject: str, point: str, seed: int, out: Path) -> str:
    """The verdict's first sentence, and the report kept; nothing where there is none."""
    if not report.exists():
        return ""
    text = report.read_text(encoding="utf-8")
    folder = out / "reports" / subject.replace(":", "-")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{kept_as(point, seed)}.json").write_text(text, encoding="utf-8")
    told: dict[str, Any] = json.loads(text)["verdict"]
    return str(told["sentence"]).partition(". ")[0]


def _write_sheet(out: Path, subject: str, name: str, pictures: Tensor) -> None:
    """Two of the lights, one above the other."""
    folder = out / "sheets" / subject.replace(":", "-")
    folder.mkdir(parents=True, exist_ok=True)
    sheet = torch.cat([pictures[light] for light in _SHOWN], dim=1)
    linear = srgb_decode_tensor(sheet).permute(1, 2, 0).contiguous().numpy()
    write_picture(linear, folder / f"{name}.png")
