"""One runner for every experiment: subjects x configurations x measures, a row of a CSV each.

An experiment names its subjects, its configurations and its measures:

- a *subject* is a name and a function that prepares it once (takes its photographs, relights true
  samples);
- a *configuration* is a name and a function of the prepared subject and a seed (captures it);
- a *measure* is a function of the prepared subject and the configuration's outcome to named numbers
  and words, the columns of the CSV. An outcome that is such a mapping needs none.

To add one, write the function and list it in the experiment. Read next: results.py, which keeps
the rows and aggregates them.
"""

from __future__ import annotations

import hashlib
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Generic, TypeVar

from matcap.errors import MatcapError, UsageError
from matcap_lab.experiment.results import Trial, Value, append, machine, read

Subject = TypeVar("Subject")  # what is prepared of one
Outcome = TypeVar("Outcome")  # what a configuration makes of it

Measure = Callable[[Subject, Outcome], Mapping[str, Value]]


@dataclass(frozen=True)
class Configuration(Generic[Subject, Outcome]):
    """One configuration of an experiment: a function of a prepared subject and a seed."""

    run: Callable[[Subject, int], Outcome]
    """(prepared subject, seed) to the outcome."""
    group: str = ""
    """The option varied; configurations of a group share a colour in the plot."""
    settings: object = None
    """Everything else its values depend on, compared by its `repr`."""


@dataclass(frozen=True)
class Experiment(Generic[Subject, Outcome]):
    """Subjects, configurations and measures."""

    name: str
    """Name of the command, `matcap-lab bench NAME`."""
    subjects: Mapping[str, Callable[[], Subject]]
    """Preparation functions by name, called only if a trial of the subject is missing."""
    configurations: Mapping[str, Configuration[Subject, Outcome]]
    """Configurations by name."""
    measures: Sequence[Measure[Subject, Outcome]] = ()
    """Measures in the order of their columns, after `seconds`, the configuration's run time.
    Without any, the outcome is the columns."""
    seeds: Sequence[int] = (0,)
    """Seeds that each configuration runs with."""
    skips: Callable[[str, str], bool] = field(default=lambda _subject, _configuration: False)
    """(subject, configuration): whether that trial is left out."""
    settings: object = None
    """Everything else its values depend on, compared by its `repr`."""
    any_version: bool = False
    """Rows measured by another version of the source are kept: for sweeps of hours."""

    def version(self, configuration: str) -> str:
        """Hash of the source and a configuration's settings, eight hexadecimal digits."""
        source = "" if self.any_version else source_version()
        identity = f"{source}{self.settings!r}{self.configurations[configuration].settings!r}"
        return hashlib.sha256(identity.encode()).hexdigest()[:8]


def run(
    experiment: Experiment[Subject, Outcome],
    table: Path,
    on_progress: Callable[[str], None] = lambda _line: None,
) -> list[Trial]:
    """Measure the trials that the table lacks, append them, and return the experiment's rows.

    A row is measured again only if matcap's source or the experiment's settings have changed.
    Captures that fail are reported by `on_progress` and left out.

    Raises:
        UsageError: a subject or a configuration was given invalid options.
        MatcapError: the table cannot be read or written; nothing could be measured.
    """
    versions = {name: experiment.version(name) for name in experiment.configurations}

    def usable(row: Trial) -> bool:
        unknown = experiment.any_version and not row.version
        return row.experiment == experiment.name and (
            unknown or row.version == versions.get(row.configuration)
        )

    done = {row.key for row in read(table) if usable(row)}
    for seed in experiment.seeds:
        for subject, prepare in experiment.subjects.items():
            left = [
                name
                for name in experiment.configurations
                if (experiment.name, name, subject, seed) not in done
                and not experiment.skips(subject, name)
            ]
            try:
                prepared = prepare() if left else None
            except UsageError:
                raise
            except MatcapError as error:
                on_progress(f"{subject}: {error}")
                continue
            for name in left:
                assert prepared is not None
                try:
                    values = _measured(experiment, prepared, name, seed)
                except UsageError:
                    raise
                except MatcapError as error:
                    on_progress(f"{subject}, {name}: {error}")
                    continue
                group = experiment.configurations[name].group
                row = Trial(
                    experiment.name, name, subject, values, group, seed, machine(), versions[name]
                )
                append(table, row)
                on_progress(row.line)
    rows = {row.key: row for row in read(table) if usable(row)}
    asked = [
        (experiment.name, name, subject, seed)
        for seed in experiment.seeds
        for subject in experiment.subjects
        for name in experiment.configurations
    ]
    available = [rows[key] for key in asked if key in rows]
    if not available:
        raise MatcapError.at(table, "nothing could be measured", "correct the errors printed above")
    return available


def choose(known: Mapping[str, Outcome], names: Sequence[str]) -> dict[str, Outcome]:
    """The entries of these names; all entries if no names are given.

    Raises:
        UsageError: a name is unknown.
    """
    for name in names:
        if name not in known:
            remedy = f"choose from {', '.join(known)}"
            raise UsageError.at(name, "there is none of this name", remedy)
    return {name: known[name] for name in names or known}


@cache
def source_version() -> str:
    """Hash of the package's files, networks included."""
    digest = hashlib.sha256()
    package = find_spec("matcap")
    for folder in package.submodule_search_locations or () if package else ():
        for file in sorted(Path(folder).rglob("*")):
            if file.suffix in (".py", ".c", ".h", ".safetensors"):
                digest.update(file.read_bytes())
    return digest.hexdigest()


def _measured(
    experiment: Experiment[Subject, Outcome], prepared: Subject, name: str, seed: int
) -> dict[str, Value]:
    """All columns of one trial."""
    began = perf_counter()
    outcome = experiment.configurations[name].run(prepared, seed)
    values: dict[str, Value] = {"seconds": perf_counter() - began}
    if not experiment.measures:
        assert isinstance(outcome, Mapping)
        values.update(outcome)
    for measure in experiment.measures:
        values.update(measure(prepared, outcome))
    return values


# Wall and processor times of calls.


def in_turn(calls: Sequence[Callable[[], object]], repeats: int) -> tuple[list[float], list[float]]:
    """Median wall and processor times of each call, s; the calls alternate."""
    wall: list[list[float]] = [[] for _ in calls]
    processor: list[list[float]] = [[] for _ in calls]
    for _ in range(repeats):
        for index, call in enumerate(calls):
            started, worked = time.perf_counter(), time.process_time()
            call()
            wall[index].append(time.perf_counter() - started)
            processor[index].append(time.process_time() - worked)
    return [statistics.median(t) for t in wall], [statistics.median(t) for t in processor]
