"""Results of experiments: a CSV with a row a trial, its table, means and Pareto front.

A row is added as soon as it is measured, so that an experiment can be stopped and resumed.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import platform
import shlex
import statistics
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matcap.errors import MatcapError
from matcap.files.output import Output

Value = float | str

_KEYS = ("experiment", "group", "configuration", "subject", "seed", "machine", "version")


@dataclass(frozen=True)
class Trial:
    """One configuration of an experiment on one subject."""

    experiment: str
    configuration: str
    subject: str
    values: Mapping[str, Value]
    """Values by column; NaN if missing."""
    group: str = ""
    seed: int = 0
    machine: str = ""
    version: str = ""
    """Hash of the source and settings that measured it (runner.Experiment.version)."""

    @property
    def key(self) -> tuple[str, str, str, int]:
        """Identity of the trial: a later row of the same key replaces an earlier one."""
        return self.experiment, self.configuration, self.subject, self.seed

    @property
    def line(self) -> str:
        """The trial in one line, for progress."""
        parts = (f"{name} {shown(value)}" for name, value in self.values.items() if shown(value))
        seed = f", seed {self.seed}" if self.seed else ""
        return f"{self.subject}, {self.configuration}{seed}: {', '.join(parts)}"

    def number(self, column: str) -> float:
        """A column's number; NaN if missing."""
        value = self.values.get(column, math.nan)
        return value if isinstance(value, float | int) else math.nan


@dataclass(frozen=True)
class Mean:
    """Averages of a configuration over its subjects, by column."""

    configuration: str
    group: str
    subjects: int
    """Number of subjects."""
    seeds: int
    """Number of seeds of the subject with the fewest."""
    values: Mapping[str, float]
    """Means over the subjects' means over seeds."""
    spread: Mapping[str, float]
    """Standard deviations over the subjects."""
    scatter: Mapping[str, float]
    """Standard deviations over seeds, averaged over the subjects; NaN with one seed."""

    def __getitem__(self, column: str) -> float:
        """A column's mean; NaN if missing."""
        return self.values.get(column, math.nan)


def read(path: Path) -> list[Trial]:
    """The rows of a CSV; none where there is no file. A torn last line is left out.

    Raises:
        MatcapError: it is no such table.
    """
    if not path.exists():
        return []
    try:
        whole = path.read_text(encoding="utf-8").rpartition("\n")[0]
        return [_trial(row) for row in csv.DictReader(io.StringIO(whole))]
    except (KeyError, TypeError, ValueError, UnicodeDecodeError, csv.Error) as error:
        raise MatcapError.at(
            path,
            f"this is not a table of measurements ({error})",
            "give a CSV that matcap-lab bench wrote, or choose another folder with -o",
        ) from error


def append(path: Path, row: Trial) -> None:
    """Add a row: the table is written anew, whole or not at all."""
    rows = [*read(path), row]
    names = [*_KEYS, *columns_of(rows)]
    with Output.file(path) as file, file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        for each in rows:
            cells = [getattr(each, n) if n in _KEYS else each.values.get(n, "") for n in names]
            writer.writerow(_written(cell) for cell in cells)


def columns_of(rows: Iterable[Trial]) -> list[str]:
    """Names of all columns, in order of first appearance."""
    return list(dict.fromkeys(name for row in rows for name in row.values))


def means(rows: Iterable[Trial], base: str | None = None) -> list[Mean]:
    """Means over the subjects, in order of first appearance; of equal keys the last row counts.

    Args:
        rows: the trials.
        base: baseline. A configuration measured on fewer subjects gets the baseline's mean times
            its ratio to the baseline on the shared subjects, because subjects differ by more than
            configurations do. None for plain means.
    """
    latest = {row.key: row for row in rows}
    by_configuration: dict[str, dict[str, list[Trial]]] = {}
    for row in latest.values():
        by_configuration.setdefault(row.configuration, {}).setdefault(row.subject, []).append(row)
    columns = columns_of(latest.values())
    paired = by_configuration.get(base, {}) if base else {}
    return [
        _mean_of(name, of_subjects, paired, columns)
        for name, of_subjects in by_configuration.items()
    ]


def comparable(averages: Sequence[Mean]) -> list[Mean]:
    """The configurations measured on the largest number of subjects."""
    most = max((mean.subjects for mean in averages), default=0)
    return [mean for mean in averages if mean.subjects == most]


def front(averages: Sequence[Mean], x: str, y: str) -> list[Mean]:
    """The Pareto front by ascending x: no other configuration is as small in both x and y."""
    best, least = [], math.inf
    for mean in sorted(averages, key=lambda mean: (mean[x], mean[y])):
        if mean[y] < least:
            best.append(mean)
            least = mean[y]
    return best


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> list[str]:
    """Lines of a table: the first `words` columns left-aligned, numbers right-aligned."""
    rule = ["---"] * words + ["---:"] * (len(head) - words)
    return ["| " + " | ".join(line) + " |" for line in (head, rule, *rows)]


def command_line() -> str:
    """This process's command, as typed in a shell."""
    return shlex.join(["matcap-lab", *sys.argv[1:]])


def table(rows: Sequence[Trial], command: str, about: str = "") -> str:
    """All rows and, if there are several subjects, each configuration's mean, in Markdown."""
    columns = columns_of(rows)
    seeds = len({row.seed for row in rows}) > 1
    lines = [
        [row.subject, row.configuration + (f", seed {row.seed}" if seeds else "")]
        + [shown(row.values.get(name, math.nan)) for name in columns]
        for row in rows
    ]
    if len({row.subject for row in rows}) > 1:
        lines += [
            ["mean", mean.configuration, *(shown(mean[name]) for name in columns)]
            for mean in means(rows)
        ]
    head = ["subject", "configuration", *columns]
    paragraphs = [about, ""] if about else []
    return (
        "\n".join([f"Measured by `{command}`.", "", *paragraphs, *markdown(head, lines, 2)]) + "\n"
    )


def as_json(rows: Sequence[Trial]) -> str:
    """The rows as a JSON list; null where there is no number."""
    entries = [
        {"subject": row.subject, "configuration": row.configuration, "seed": row.seed}
        | {n: None if v != v else v for n, v in row.values.items()}
        for row in rows
    ]
    return json.dumps(entries, indent=2)


def shown(value: Value) -> str:
    """A number to three digits, an empty string for NaN; words unchanged."""
    if isinstance(value, str):
        return value
    if math.isnan(value):
        return ""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:#.3g}".rstrip(".")


def machine() -> str:
    """Processor, number of cores and threads, and operating system."""
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


def _mean_of(
    name: str,
    of_subjects: Mapping[str, Sequence[Trial]],
    base: Mapping[str, Sequence[Trial]],
    columns: Sequence[str],
) -> Mean:
    """Averages of one configuration from its trials by subject."""

    def over_seeds(column: str, trials: Mapping[str, Sequence[Trial]]) -> dict[str, float]:
        return {subject: _mean([t.number(column) for t in of]) for subject, of in trials.items()}

    def mean(column: str) -> float:
        own, paired = over_seeds(column, of_subjects), over_seeds(column, base)
        shared = [s for s, value in own.items() if not math.isnan(value + paired.get(s, math.nan))]
        if not shared:
            return _mean(list(own.values()))
        ratio = _mean([own[s] for s in shared]) / _mean([paired[s] for s in shared])
        return ratio * _mean(list(paired.values()))

    def scatter(column: str) -> float:
        several = [of for of in of_subjects.values() if len(of) > 1]
        return _mean([_deviation([t.number(column) for t in of]) for of in several])

    return Mean(
        name,
        next(iter(of_subjects.values()))[0].group,
        len(of_subjects),
        min(map(len, of_subjects.values())),
        {column: mean(column) for column in columns},
        {c: _deviation(list(over_seeds(c, of_subjects).values())) for c in columns},
        {column: scatter(column) for column in columns},
    )


def _trial(row: dict[str, str | None]) -> Trial:
    keys = {name: row.pop(name, "") or "" for name in _KEYS}
    if not keys["experiment"] or not keys["configuration"] or None in row:
        raise ValueError("no experiment and configuration stand in it")
    values = {name: _value(text or "") for name, text in row.items()}
    return Trial(values=values, seed=int(keys.pop("seed") or 0), **keys)


def _value(text: str) -> Value:
    try:
        return float(text or "nan")
    except ValueError:
        return text


def _written(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.6g}"
    return str(value)


def _mean(values: Sequence[float]) -> float:
    """Mean of the values that are not NaN."""
    known = [value for value in values if not math.isnan(value)]
    return statistics.fmean(known) if known else math.nan


def _deviation(values: Sequence[float]) -> float:
    """Standard deviation of the values that are not NaN; NaN where one is infinite."""
    known = [value for value in values if not math.isnan(value)]
    return statistics.pstdev(known) if known and all(map(math.isfinite, known)) else math.nan
