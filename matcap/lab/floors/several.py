"""`matcap bench floors --photographs 1,2,3,5`: what several photographs of one piece are worth."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from matcap.brdf.maps import MapSet
from matcap.capture.piece.find import piece_maps
from matcap.capture.pipeline import capture_file
from matcap.capture.result import CaptureResult
from matcap.errors import MatcapError
from matcap.lab.bench.table import Point
from matcap.lab.floors.distance import Measure
from matcap.lab.floors.run import FloorRow, FloorSettings, Judge, MapNumbers, middle_of, side_of
from matcap.lab.simulate.hand_held import (
    Hand,
    HeldShot,
    Room,
    held_on,
    hold,
    take_several,
    take_without_flash,
)
from matcap.lab.simulate.specimen import Specimen
from matcap.lab.simulate.write_dng import write_dng
from matcap.lab.simulate.write_jpeg import write_jpeg

_STEEP = 3.0  # degrees: where normals are compared


@dataclass(frozen=True)
class SeveralRow:
    """A capture of so many photographs.

    Attributes:
        floors: of the piece, as floors are told of one photograph.
        photographs: with flash that were given.
        without: flash, likewise.
        used: of both.
        normals: degrees that normals are off where the truth leans by more than _STEEP; NaN where
            it nowhere does. `flat` is what a flat piece would be off there.
        albedo: mean size of the difference of log albedo, its mean left out.
        roughness: mean size of the difference.
        residual, predicted: medians over photographs, of log radiance; predicted by all others.
    """

    floors: FloorRow
    photographs: int
    without: int
    used: int
    normals: float
    flat: float
    albedo: float
    roughness: float
    residual: float
    predicted: float


def run_several(
    chosen: Sequence[Specimen],
    counts: Sequence[int],
    out: Path,
    settings: FloorSettings,
    measure: Measure,
    *,
    room: float = 0.0,
    tell: Callable[[str], None] = lambda _line: None,
) -> list[SeveralRow]:
    """Photograph pieces from several places, capture and judge; what fails is told and left out.

    Args:
        chosen: materials.
        counts: of photographs.
        out: folder for the photographs.
        settings: how; photographs are JPEGs or RAW as it says.
        measure: what by.
        room: irradiance by its light (hand_held.Room); each count is captured without and with
            one more photograph without flash. 0 for darkness, without that.
        tell: called with a line for each capture.
    """
    hand = Hand(room=Room(room) if room else None)
    phone, rows = settings.camera, []
    for subject in chosen:
        realise = subject.pieces(subject.seed)
        cameras = hold(phone, hand, max(counts), subject.seed)
        shots = take_several(realise, phone, cameras, hand, subject.seed)
        paths = [_write(subject, shot, number, out, settings) for number, shot in enumerate(shots)]
        judge = Judge(subject, shots[0].shot.setup, settings, measure)
        dark = []
        if room:
            unlit = take_without_flash(realise, phone, cameras, hand, subject.seed + 1)
            dark = [_write(subject, unlit, len(paths), out, settings)]
        for count, extra in itertools.product(counts, ([], dark) if room else ([],)):
            try:
                others = [*paths[1:count], *extra]
                result = capture_file(paths[0], settings.captured, others=others)
            except MatcapError as error:
                tell(f"{subject.name}, {count}: {error}")
                continue
            truth = held_on(realise, phone, cameras, result.material.setup, _bent(result))
            row = _judged(subject, (count, len(extra)), result, truth, judge, settings)
            tell(_line(row))
            rows.append(row)
    return rows


def _write(
    subject: Specimen, shot: HeldShot, number: int, out: Path, settings: FloorSettings
) -> Path:
    name = f"{subject.name.replace(':', '-')}_{number}"
    if settings.jpeg:
        path = out / f"{name}.jpg"
        write_jpeg(path, shot.shot, subject.seed + number)
    else:
        path = out / f"{name}.dng"
        write_dng(path, shot.shot, subject.sensor, subject.seed + number)
    return path


def _bent(result: CaptureResult) -> tuple[float, float]:
    several = None if result.found is None else result.found.several
    return (0.0, 0.0) if several is None else several.bent


def _judged(
    subject: Specimen,
    given: tuple[int, int],
    result: CaptureResult,
    truth: Callable[[int, int], MapSet],
    judge: Judge,
    settings: FloorSettings,
) -> SeveralRow:
    assert result.found is not None
    piece = piece_maps(result.found.exemplar)
    true = truth(*piece.size)
    middle = middle_of(piece, side_of(piece.texel_size, settings))
    told, numbers = MapNumbers.of(middle), judge.true_numbers(piece.texel_size)
    floors = judge.floors(middle, result.material.setup.intensity)
    row = FloorRow(
        subject.name, f"{given[0]} photographs", floors,
        told.tilt, numbers.tilt, told.albedo, numbers.albedo, told.roughness, numbers.roughness,
        sum(result.stage_seconds.values()),
    )  # fmt: skip
    off = (true.normal.float() * piece.normal).sum(0).clamp(-1.0, 1.0).acos().rad2deg()
    lean = true.normal[2].clamp(-1.0, 1.0).acos().rad2deg()
    steep = lean > _STEEP
    log = (piece.diffuse.mean(0) + 1e-3).log() - (true.diffuse.mean(0) + 1e-3).log()
    several = result.found.several
    return SeveralRow(
        row,
        *given,
        1 if several is None else len(several.views),
        float(off[steep].mean()) if steep.any() else math.nan,
        float(lean[steep].mean()) if steep.any() else math.nan,
        float((log - log.median()).abs().mean()),
        float((piece.roughness - true.roughness).abs().mean()),
        math.nan if several is None else _median(several.residuals),
        math.nan if several is None else _median(several.predicted),
    )


def _median(values: Sequence[float]) -> float:
    return float(torch.tensor(values).nanmedian()) if values else math.nan


def _line(row: SeveralRow) -> str:
    return (
        f"{row.floors.material}, {_count(row)} ({row.used} used): {row.floors.floors:.2f} "
        f"floors, normals {row.normals:.1f} of {row.flat:.1f}, albedo {row.albedo:.3f}, roughness "
        f"{row.roughness:.3f}, residual {row.residual:.3f}, predicted {row.predicted:.3f}, "
        f"{row.floors.seconds:.0f} s"
    )


def _count(row: SeveralRow) -> str:
    return f"{row.photographs} + {row.without}" if row.without else str(row.photographs)


def several_markdown(rows: Sequence[SeveralRow], command: str) -> str:
    """A table: a line a material and count, and means over the materials."""
    lines = [
        f"Measured by `{command}`.",
        "",
        "| material | photographs | used | floors | tilt told / true | normals off, of "
        "| albedo off | roughness off | residual | predicted | seconds |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        one = row.floors
        lines.append(
            f"| {one.material} | {_count(row)} | {row.used} | {one.floors:.2f} | {one.tilt:.1f}"
            f" / {one.true_tilt:.1f} | {row.normals:.1f}, {row.flat:.1f} | {row.albedo:.3f} "
            f"| {row.roughness:.3f} | {row.residual:.3f} | {row.predicted:.3f} "
            f"| {one.seconds:.0f} |"
        )
    for count in dict.fromkeys(_count(row) for row in rows):
        of = [row for row in rows if _count(row) == count]
        floors = sum(row.floors.floors for row in of) / len(of)
        lines.append(f"| mean | {count} | | {floors:.2f} | | | | | | | |")
    return "\n".join(lines) + "\n"


def several_points(rows: Sequence[SeveralRow]) -> list[Point]:
    """Floors against seconds, for a picture (bench/plot.py): a group each material, and means."""
    counts = list(dict.fromkeys(_count(row) for row in rows))
    groups: dict[str, list[SeveralRow]] = {}
    for row in rows:
        groups.setdefault(row.floors.material, []).append(row)
    # A mean of other materials than the next one's would tell of those.
    whole = [of for of in groups.values() if len(of) == len(counts)]
    points = [_point(name, [row]) for name, of in groups.items() for row in of]
    for place in range(len(counts) if len(whole) > 1 else 0):
        points.append(_point("mean", [of[place] for of in whole]))
    return points


def _point(group: str, rows: Sequence[SeveralRow]) -> Point:
    floors = torch.tensor([row.floors.floors for row in rows])
    seconds = sum(row.floors.seconds for row in rows) / len(rows)
    count = f"{_count(rows[0])} photographs"
    return Point(group, count, len(rows), seconds, math.nan, float(floors.mean()), 0.0)
