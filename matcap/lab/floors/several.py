"""`matcap bench floors --photographs 1,2,3,5`: what several photographs of one piece are worth."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.piece.find import piece_maps
from matcap.capture.pipeline import capture_file
from matcap.capture.result import CaptureResult
from matcap.capture.together.union import UNION, sees
from matcap.errors import MatcapError
from matcap.flash.registration.camera import PosedCamera
from matcap.flash.registration.grid import grid_points
from matcap.lab.bench.table import Point
from matcap.lab.floors.distance import Measure
from matcap.lab.floors.run import FloorRow, FloorSettings, Judge, MapNumbers, middle_of, side_of
from matcap.lab.simulate.hand_held import (
    Hand,
    HeldShot,
    Room,
    held_along,
    held_on,
    hold,
    take_several,
    take_without_flash,
)
from matcap.lab.simulate.photograph import PhoneCamera, Realise
from matcap.lab.simulate.specimen import Specimen
from matcap.lab.simulate.write_dng import write_dng
from matcap.lab.simulate.write_jpeg import write_jpeg

_STEEP = 3.0  # degrees: where normals are compared


@dataclass(frozen=True)
class MapsOff:
    """What maps are off by.

    Attributes:
        normals: degrees that normals are off where the truth leans by more than _STEEP; NaN where
            it nowhere does. `flat` is what a flat piece would be off there.
        albedo: mean size of the difference of log albedo, its median left out.
        roughness: mean size of the difference.
    """

    normals: float
    flat: float
    albedo: float
    roughness: float

    @staticmethod
    def of(piece: MapSet, true: MapSet, where: Tensor | None = None) -> MapsOff:
        """Of a piece, or of some of it, (H, W) bool."""
        here = torch.ones(piece.size[::-1], dtype=torch.bool) if where is None else where
        off = (true.normal.float() * piece.normal).sum(0).clamp(-1.0, 1.0).acos().rad2deg()
        lean = true.normal[2].clamp(-1.0, 1.0).acos().rad2deg()
        steep = (lean > _STEEP) & here
        log = (piece.diffuse.mean(0) + 1e-3).log() - (true.diffuse.mean(0) + 1e-3).log()
        return MapsOff(
            float(off[steep].mean()) if steep.any() else math.nan,
            float(lean[steep].mean()) if steep.any() else math.nan,
            float((log - log[here].median())[here].abs().mean()),
            float((piece.roughness - true.roughness)[0][here].abs().mean()),
        )


@dataclass(frozen=True)
class SeveralRow:
    """A capture of so many photographs.

    Attributes:
        floors: of the piece, as floors are told of one photograph.
        photographs: with flash that were given.
        without: flash, likewise.
        used: of both.
        normals, flat, albedo, roughness: of the first photograph's rectangle (MapsOff).
        residual, predicted: medians over photographs, of log radiance; predicted by all others.
        times: how many times the first photograph's rectangle the piece is.
        beyond: of what only others show, where the piece reaches beyond it.
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
    times: float = 1.0
    beyond: MapsOff | None = None


def run_several(
    chosen: Sequence[Specimen],
    counts: Sequence[int],
    out: Path,
    settings: FloorSettings,
    measure: Measure,
    *,
    room: float = 0.0,
    hand: Hand | None = None,
    union: bool = False,
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
        hand: that holds the phone.
        union: each count of two or more is also captured as all that photographs show.
        tell: called with a line for each capture.
    """
    hand = replace(hand or Hand(), room=Room(room) if room else None)
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
        extras, wholes = ([], dark) if room else ([],), (False, True) if union else (False,)
        for count, extra, whole in itertools.product(counts, extras, wholes):
            if whole and count < 2:
                continue
            try:
                others = [*paths[1:count], *extra]
                chosen_so = replace(settings.captured, union=whole)
                result = capture_file(paths[0], chosen_so, others=others)
            except MatcapError as error:
                tell(f"{subject.name}, {count}: {error}")
                continue
            truth = held_on(realise, phone, cameras, result.material.setup, _bent(result))
            row = _judged(subject, (count, len(extra)), result, truth, judge, settings)
            names = [path.name for path in paths]
            row = replace(row, **_beyond(result, realise, phone, cameras, names))
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
    piece = piece_maps(result.found.framed)
    true = truth(*piece.size)
    middle = middle_of(piece, side_of(piece.texel_size, settings))
    told, numbers = MapNumbers.of(middle), judge.true_numbers(piece.texel_size)
    floors = judge.floors(middle, result.material.setup.intensity)
    row = FloorRow(
        subject.name, f"{given[0]} photographs", floors,
        told.tilt, numbers.tilt, told.albedo, numbers.albedo, told.roughness, numbers.roughness,
        sum(result.stage_seconds.values()),
    )  # fmt: skip
    off = MapsOff.of(piece, true)
    several = result.found.several
    return SeveralRow(
        row,
        *given,
        1 if several is None else len(several.views),
        off.normals,
        off.flat,
        off.albedo,
        off.roughness,
        math.nan if several is None else _median(several.residuals),
        math.nan if several is None else _median(several.predicted),
    )


def _beyond(
    result: CaptureResult,
    realise: Realise,
    phone: PhoneCamera,
    cameras: Sequence[PosedCamera],
    names: Sequence[str],
) -> dict[str, Any]:
    """How large a piece is, and what it is off by where the first photograph shows none of it.

    A texel that one photograph drew lies where that one was laid, which is beside its place by more
    the farther it is from the first: truth is looked up along its rays.
    """
    found = result.found
    reach = None if found is None or found.several is None else found.several.reach
    if found is None or found.several is None or reach is None:
        return {}
    piece, views = piece_maps(found.exemplar), found.several.views
    points = grid_points(*piece.size, reach.extent)
    left = ~reach.margins.own(reach.size)
    planes, known = torch.zeros(9, *piece.size[::-1]), torch.zeros_like(left)
    for view in views[1:]:
        up = view.photo.pixels.shape[0] / view.photo.pixels.shape[1]
        here = left & torch.from_numpy(sees(view.camera, points, up, UNION.steepest))
        number = names.index(view.photo.name)
        true = held_along(realise, phone, cameras, number, view.camera, reach.extent)(*piece.size)
        planes[:, here] = torch.cat([true.stacked(), true.normal]).float()[:, here]
        known, left = known | here, left & ~here
    whole = replace(MapSet.from_stacked(planes[:6], piece.texel_size), painted=planes[6:])
    return {"times": reach.times, "beyond": MapsOff.of(piece, whole, known)}


def _median(values: Sequence[float]) -> float:
    return float(torch.tensor(values).nanmedian()) if values else math.nan


def _line(row: SeveralRow) -> str:
    return (
        f"{row.floors.material}, {_count(row)} ({row.used} used): {row.floors.floors:.2f} "
        f"floors, normals {row.normals:.1f} of {row.flat:.1f}, albedo {row.albedo:.3f}, roughness "
        f"{row.roughness:.3f}, residual {row.residual:.3f}, predicted {row.predicted:.3f}, "
        f"{row.floors.seconds:.0f} s{_told_beyond(row)}"
    )


def _told_beyond(row: SeveralRow) -> str:
    if row.beyond is None:
        return ""
    off = row.beyond
    return (
        f"; {row.times:.2f} times as large, beyond: normals {off.normals:.1f} of {off.flat:.1f}, "
        f"albedo {off.albedo:.3f}, roughness {off.roughness:.3f}"
    )


def _count(row: SeveralRow) -> str:
    count = f"{row.photographs} + {row.without}" if row.without else str(row.photographs)
    return count if row.beyond is None else f"{count}, union"


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
    return "\n".join([*lines, *_beyond_lines(rows)]) + "\n"


def _beyond_lines(rows: Sequence[SeveralRow]) -> list[str]:
    """A second table, of what pieces are off by beyond the first photograph, if any reaches it."""
    lines = [
        f"| {row.floors.material} | {row.photographs} | {row.times:.2f} "
        f"| {row.beyond.normals:.1f}, {row.beyond.flat:.1f} | {row.beyond.albedo:.3f} "
        f"| {row.beyond.roughness:.3f} |"
        for row in rows
        if row.beyond is not None
    ]
    head = [
        "",
        "Beyond the first photograph:",
        "",
        "| material | photographs | times the first | normals off, of | albedo | roughness |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    return [*head, *lines] if lines else []


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
