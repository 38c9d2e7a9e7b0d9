"""One table for every bench that trades accuracy for time: a CSV with a line a measurement.

A bench appends a line as soon as it has it, and skips what is there already, so that a sweep can
be stopped and taken up again. plot.py draws tables, report.py writes
docs/notes/accuracy-and-time.md.
"""

from __future__ import annotations

import csv
import math
import os
import platform
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from matcap.errors import MatcapError


@dataclass(frozen=True)
class Measurement:
    """One thing done one way, once.

    Attributes:
        bench: what was measured: "capture", "synth", "relight".
        group: what was varied: "preset", "steps", "window" and the like.
        point: which way it was done; the same on every subject.
        subject: on what: a material, a scene.
        seconds: by the wall's clock; of captures, of the processor.
        megabytes: most memory the process held; NaN where not measured.
        error: how far from the truth; what it counts in, the bench's page says.
        piece: of captures: of the photographed piece, where `error` is of what rearranges it.
        flash: the same as `error` under the photograph's own light.
        fine: the same on twice as many texels.
        patches, filters: the same by other measures.
        clock: seconds by the wall's clock of captures.
        machine: that did it.
        seed: of everything random in it.
        verdict: of captures: what is said of it.
        seen: what was said of the photograph before.
    """

    bench: str
    group: str
    point: str
    subject: str
    seconds: float
    megabytes: float
    error: float
    piece: float = math.nan
    flash: float = math.nan
    fine: float = math.nan
    patches: float = math.nan
    filters: float = math.nan
    clock: float = math.nan
    machine: str = ""
    seed: int = 0
    verdict: str = ""
    seen: str = ""

    @property
    def key(self) -> tuple[str, str, str, int]:
        """What makes it the same measurement made again."""
        return self.bench, self.point, self.subject, self.seed


@dataclass(frozen=True)
class Point:
    """A way of doing it, over all its subjects.

    Attributes:
        group, name: of the measurements.
        subjects: how many.
        seconds, megabytes, error, piece, flash, fine, patches, filters, clock: means over the
            subjects' means over seeds.
        spread: standard deviation of the error over the subjects.
        seeds: how many each subject was measured with, at least.
        scatter: standard deviation of the error over seeds, its mean over the subjects; NaN with
            one seed.
    """

    group: str
    name: str
    subjects: int
    seconds: float
    megabytes: float
    error: float
    spread: float
    piece: float = math.nan
    flash: float = math.nan
    fine: float = math.nan
    patches: float = math.nan
    filters: float = math.nan
    clock: float = math.nan
    seeds: int = 1
    scatter: float = math.nan


_COLUMNS = tuple(field.name for field in fields(Measurement))
_ERRORS = ("error", "piece", "flash", "fine", "patches", "filters")
_NUMBERS = ("seconds", "megabytes", "clock", *_ERRORS)
_WORDS = ("bench", "group", "point", "subject")
_REMARKS = ("machine", "verdict", "seen")


def read(path: Path) -> list[Measurement]:
    """The measurements in a CSV; none where there is no file. A torn last line is left out.

    Raises:
        MatcapError: it is no such table.
    """
    if not path.exists():
        return []
    try:
        whole = path.read_text(encoding="utf-8").rpartition("\n")[0]
        return [_measurement(row) for row in csv.DictReader(whole.splitlines())]
    except (KeyError, TypeError, ValueError, UnicodeDecodeError, csv.Error) as error:
        raise MatcapError(
            f"this is not a table of measurements ({error})",
            where=str(path),
            remedy="give a CSV that matcap bench wrote",
        ) from error


def append(path: Path, measured: Measurement) -> None:
    """Add a line in place of a torn one, if a sweep was killed; the heading where it is new."""
    path.parent.mkdir(parents=True, exist_ok=True)
    before = path.read_bytes() if path.exists() else b""
    with path.open("a", newline="", encoding="utf-8") as file:
        file.truncate(before.rfind(b"\n") + 1)
        writer = csv.writer(file, lineterminator="\n")
        if not before.count(b"\n"):
            writer.writerow(_COLUMNS)
        writer.writerow([_text(getattr(measured, name)) for name in _COLUMNS])
        file.flush()
        os.fsync(file.fileno())


def points(measured: Iterable[Measurement], base: str | None = None) -> list[Point]:
    """Means over the subjects, in the order of the first measurement; the last one counts.

    Args:
        measured: what there is.
        base: a point that others are paired with: one of fewer subjects is told by its ratio to it
            on the same ones, for materials differ by more than ways do. None for plain means.
    """
    latest = {one.key: one for one in measured}
    by_point: dict[str, dict[str, list[Measurement]]] = {}
    for one in latest.values():
        by_point.setdefault(one.point, {}).setdefault(one.subject, []).append(one)
    paired = by_point.get(base, {}) if base else {}
    return [_point(name, of_subjects, paired) for name, of_subjects in by_point.items()]


def _point(
    name: str,
    of_subjects: Mapping[str, Sequence[Measurement]],
    base: Mapping[str, Sequence[Measurement]],
) -> Point:
    """The point of measurements by subject and seed."""

    def mean(number: str) -> float:
        own = {subject: _of(number, some) for subject, some in of_subjects.items()}
        beside = {subject: _of(number, some) for subject, some in base.items()}
        shared = [s for s, value in own.items() if not math.isnan(value + beside.get(s, math.nan))]
        if not shared:
            return _mean(list(own.values()))
        ratio = _mean([own[s] for s in shared]) / _mean([beside[s] for s in shared])
        return ratio * _mean(list(beside.values()))

    first = next(iter(of_subjects.values()))[0]
    several = [[one.error for one in some] for some in of_subjects.values() if len(some) > 1]
    return Point(
        group=first.group,
        name=name,
        subjects=len(of_subjects),
        spread=_deviation([_of("error", some) for some in of_subjects.values()]),
        seeds=min(len(some) for some in of_subjects.values()),
        scatter=_mean([_deviation(errors) for errors in several]),
        **{number: mean(number) for number in _NUMBERS},
    )


def _of(number: str, some: Sequence[Measurement]) -> float:
    """One number of one subject, over seeds."""
    return _mean([getattr(one, number) for one in some])


def comparable(found: Sequence[Point]) -> list[Point]:
    """Those measured on as many subjects as any."""
    most = max((point.subjects for point in found), default=0)
    return [point for point in found if point.subjects == most]


def front(found: Sequence[Point]) -> list[Point]:
    """The Pareto front, fastest first: none is both as fast and as good."""
    best, least = [], math.inf
    for point in sorted(found, key=lambda point: (point.seconds, point.error)):
        if point.error < least:
            best.append(point)
            least = point.error
    return best


def machine() -> str:
    """The processor, its cores and the threads in use, and the system."""
    import torch

    return (
        f"{_processor()}, {os.cpu_count()} cores, {torch.get_num_threads()} threads, "
        f"{platform.system()}, torch {torch.__version__.split('+')[0]}"
    )


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass  # no such file but on Linux
    return platform.processor() or platform.machine()


def _measurement(row: dict[str, str]) -> Measurement:
    # Older tables lack some.
    numbers = {name: float(row.get(name) or "nan") for name in _NUMBERS}
    words = {name: row[name] for name in _WORDS}
    words |= {name: row.get(name) or "" for name in _REMARKS}
    seed = int(row.get("seed") or 0)
    return Measurement(**words, **numbers, seed=seed)  # type: ignore[arg-type]


def _text(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.6g}"
    return str(value)


def _known(values: Sequence[float]) -> list[float]:
    return [value for value in values if not math.isnan(value)]


def _mean(values: Sequence[float]) -> float:
    """Of those that are numbers."""
    known = _known(values)
    return statistics.fmean(known) if known else math.nan


def _deviation(values: Sequence[float]) -> float:
    """Of those that are numbers."""
    known = _known(values)
    return statistics.pstdev(known) if known else math.nan
