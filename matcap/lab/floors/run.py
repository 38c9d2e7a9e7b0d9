"""`matcap bench floors`: captures of known materials, judged by a measure that nothing is tuned by.

A piece of a material is photographed and captured. The photograph as albedo, the piece that was
found and the field that rearranges it are relit from several directions and compared with other
true pieces; errors are multiples of what those differ by (distance.py). Beside them what the maps
tell, for what is true: mean tilt, deviation of log albedo, roughness.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.piece.find import piece_maps
from matcap.capture.pipeline import capture_file
from matcap.capture.result import CaptureResult
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError
from matcap.files.rec709 import LUMINANCE
from matcap.flash.geometry import FlashSetup
from matcap.lab.bench.baselines import photo_as_albedo
from matcap.lab.bench.relit import BenchScene, bench_scene, relight_all
from matcap.lab.floors.distance import Floor, Measure
from matcap.lab.simulate.photograph import PhoneCamera, Shot, as_photo
from matcap.lab.simulate.specimen import Specimen, photograph

ALBEDO, PIECE, FIELD = "photograph as albedo", "piece", "field"

_EVERY = 2  # of the bench's lights
_DARK = 1e-3  # of albedo


@dataclass(frozen=True)
class FloorSettings:
    """How captures are made and judged.

    Attributes:
        captured: settings of the captures; their detail is what the piece is found in.
        detail: texels along the photograph's long side of the pictures compared.
        size: texels a side of them, at least 128; of the middle of the plane.
        stops: that the photograph is exposed above what the camera would choose.
        jpeg: photographs are JPEGs, instead of RAW.
        camera: that takes them.
        truths: pieces that captures are compared with, at least 2.
        finer: true radiance is averaged over this many texels a side: it has detail below a pixel.
    """

    captured: CaptureSettings = field(default_factory=CaptureSettings)
    detail: int = 512
    size: int = 256
    stops: float = 0.0
    jpeg: bool = False
    camera: PhoneCamera = field(default_factory=PhoneCamera)
    truths: int = 3
    finer: int = 4


@dataclass(frozen=True)
class MapNumbers:
    """What maps tell in three numbers.

    Attributes:
        tilt: mean angle of the normal from the plane's, degrees.
        albedo: standard deviation of the logarithm of diffuse albedo's luminance.
        roughness: mean.
    """

    tilt: float
    albedo: float
    roughness: float

    @staticmethod
    def of(maps: MapSet) -> MapNumbers:
        """Of one map set."""
        luminance = torch.tensor(LUMINANCE)[:, None, None] * maps.diffuse.float()
        return MapNumbers(
            float(maps.normal[2].clamp(-1.0, 1.0).acos().rad2deg().mean()),
            float((luminance.sum(0) + _DARK).log().std()),
            float(maps.roughness.mean()),
        )


@dataclass(frozen=True)
class FloorRow:
    """One thing on one material.

    Attributes:
        material, method: which.
        floors: error in multiples of the floor; 1 is indistinguishable.
        tilt, albedo, roughness: what the maps tell (MapNumbers).
        true_tilt, true_albedo, true_roughness: of other true pieces, in the same detail.
        seconds: that the capture took.
    """

    material: str
    method: str
    floors: float
    tilt: float
    true_tilt: float
    albedo: float
    true_albedo: float
    roughness: float
    true_roughness: float
    seconds: float


class Judge:
    """True pieces of a material, relit and described."""

    def __init__(
        self, subject: Specimen, flash: FlashSetup, settings: FloorSettings, measure: Measure
    ) -> None:
        """Relight true pieces, none of them the photographed one.

        Args:
            subject: the material.
            flash: the true setup of the photograph.
            settings: sizes.
            measure: what pictures are compared by.
        """
        whole = bench_scene(flash)
        self.scene = BenchScene(whole.distance, whole.lights[::_EVERY])
        self._settings, self._measure = settings, measure
        finest = settings.detail * settings.finer
        texel, pixels = 2.0 / finest, settings.size * settings.finer
        seeds = [subject.seed + 1 + number for number in range(settings.truths)]
        self._truths = [subject.pieces(seed)(pixels, pixels, texel) for seed in seeds]
        self._blur = settings.camera.blur * finest / settings.camera.width
        self._flash = flash
        self._size = (settings.size, settings.size)
        self.pictures = self.relit_truths(self.scene)
        self.floor = Floor([measure.style(pictures) for pictures in self.pictures])

    def relit_truths(self, scene: BenchScene) -> list[Tensor]:
        """(L, 3, H, W) of each true piece, under a scene's lights."""
        intensity = self._flash.intensity
        return [
            relight_all(maps, intensity, scene, size=self._size, blur=self._blur)
            for maps in self._truths
        ]

    def relit(
        self,
        maps: MapSet,
        intensity: tuple[float, float, float],
        scene: BenchScene | None = None,
    ) -> Tensor:
        """(L, 3, H, W) of maps under the flash that goes with them, as truths are compared."""
        floats = maps.map(lambda m: m.float())
        return relight_all(floats, intensity, scene or self.scene, size=self._size)

    def floors(self, maps: MapSet, intensity: tuple[float, float, float]) -> float:
        """Error of maps under the flash that goes with them, in floors."""
        return self.floor.of(self._measure.style(self.relit(maps, intensity)))

    def true_numbers(self, texel_size: float) -> MapNumbers:
        """Of the true pieces, in texels of a size."""
        shrunk = [MapNumbers.of(_shrunk(maps, texel_size)) for maps in self._truths]
        mean = {
            name: sum(getattr(one, name) for one in shrunk) / len(shrunk)
            for name in (each.name for each in fields(MapNumbers))
        }
        return MapNumbers(**mean)


def judge_capture(
    subject: Specimen, shot: Shot, result: CaptureResult, settings: FloorSettings, measure: Measure
) -> list[FloorRow]:
    """What a capture came to: the photograph as albedo, the piece, the field.

    Args:
        subject: the material.
        shot: its photograph.
        result: what was made of that.
        settings: how it is judged.
        measure: what by.
    """
    assert result.found is not None
    judge = Judge(subject, shot.setup, settings, measure)
    photo = as_photo(shot, subject.seed, subject.name)
    albedo = photo_as_albedo(photo, shot.setup, settings.detail)
    piece = piece_maps(result.found.exemplar)
    side = side_of(piece.texel_size, settings)
    endless = result.material.maps(side, side, seed=0)
    own = result.material.setup.intensity
    seconds = sum(result.stage_seconds.values())

    def row(method: str, maps: MapSet, intensity: tuple[float, float, float]) -> FloorRow:
        middle = middle_of(maps, side_of(maps.texel_size, settings))
        told, true = MapNumbers.of(middle), judge.true_numbers(maps.texel_size)
        return FloorRow(
            subject.name, method, judge.floors(middle, intensity),
            told.tilt, true.tilt, told.albedo, true.albedo, told.roughness, true.roughness,
            seconds,
        )  # fmt: skip

    return [
        row(ALBEDO, albedo.whole, albedo.setup.intensity),
        row(PIECE, piece, own),
        row(FIELD, endless, own),
    ]


def run_floors(
    chosen: Sequence[Specimen],
    out: Path,
    settings: FloorSettings | None = None,
    *,
    measure: Measure | None = None,
    tell: Callable[[str], None] = lambda _line: None,
) -> list[FloorRow]:
    """Photograph, capture and judge; what cannot be captured is told and left out.

    Args:
        chosen: materials.
        out: folder for the photographs.
        settings: how.
        measure: what by; SqueezeNet by default.
        tell: called with a line for each row.

    Raises:
        MatcapError: `out` cannot be written.
    """
    settings, measure = settings or FloorSettings(), measure or Measure()
    rows = []
    for subject in chosen:
        path, shot = photograph(
            subject, settings.camera, out, stops=settings.stops, jpeg=settings.jpeg
        )
        try:
            result = capture_file(path, settings.captured)
        except MatcapError as error:
            tell(f"{subject.name}: {error}")
            continue
        for row in judge_capture(subject, shot, result, settings, measure):
            tell(_line(row))
            rows.append(row)
    return rows


def floors_markdown(rows: Sequence[FloorRow], command: str) -> str:
    """A table: a line a material and method, and means over the materials."""
    lines = [
        f"Measured by `{command}`. Floors: SqueezeNet's style under new lights; 1 is what two true "
        "pieces differ by (matcap/lab/floors/distance.py). Numbers of maps: told / true.",
        "",
        "| material | method | floors | mean tilt | log albedo deviates by | roughness | seconds |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        lines.append(
            f"| {row.material} | {row.method} | {row.floors:.2f} "
            f"| {row.tilt:.1f} / {row.true_tilt:.1f} | {row.albedo:.2f} / {row.true_albedo:.2f} "
            f"| {row.roughness:.2f} / {row.true_roughness:.2f} | {row.seconds:.0f} |"
        )
    for method in dict.fromkeys(row.method for row in rows):
        of = [row.floors for row in rows if row.method == method]
        lines.append(f"| mean | {method} | {sum(of) / len(of):.2f} | | | | |")
    return "\n".join(lines) + "\n"


def floors_csv(rows: Sequence[FloorRow]) -> str:
    """The rows as CSV."""
    stream = io.StringIO()
    names = [each.name for each in fields(FloorRow)]
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        told = asdict(row).items()
        writer.writerow({k: f"{v:.4f}" if isinstance(v, float) else v for k, v in told})
    return stream.getvalue()


def _line(row: FloorRow) -> str:
    return f"{row.material:12} {row.method:20} {row.floors:5.2f} floors"


def side_of(texel_size: float, settings: FloorSettings) -> int:
    """Texels of a size along the side of what is compared."""
    return round(settings.size * 2.0 / settings.detail / texel_size)


def middle_of(maps: MapSet, side: int) -> MapSet:
    """The middle square.

    Raises:
        MatcapError: the maps are smaller.
    """
    width, height = maps.size
    if min(width, height) < side:
        raise MatcapError(
            f"the capture gives {width} x {height} texels, {side} x {side} are compared",
            remedy="compare smaller pictures",
        )
    return maps.crop((width - side) // 2, (height - side) // 2, side, side)


def _shrunk(maps: MapSet, texel_size: float) -> MapSet:
    """Means over texels of a size, no finer than the maps'."""
    width, height = maps.size
    share = min(1.0, maps.texel_size / texel_size)
    size = (round(height * share), round(width * share))
    stacked: Tensor = F.interpolate(maps.stacked()[None].float(), size, mode="area")[0]
    return MapSet.from_stacked(stacked, maps.texel_size * width / size[1])
