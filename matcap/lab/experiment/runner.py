"""One runner for every experiment: subjects x configurations x measures, a row of a CSV each.

An experiment names its subjects, its configurations and its measures:

- a *subject* is a name and a function that prepares it once (takes its photographs, relights true
  samples);
- a *configuration* is a name and a function of the prepared subject and a seed (captures it);
- a *measure* is a function of the prepared subject and what the configuration made of it, to named
  numbers and words, which are columns of the CSV.

To add one, write the function and list it in the experiment. Read next: results.py, which keeps
the rows and aggregates them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Generic, TypeVar

from matcap.errors import MatcapError, UsageError
from matcap.lab.experiment.results import Trial, Value, append, machine, read

Subject = TypeVar("Subject")  # what is prepared of one
Outcome = TypeVar("Outcome")  # what a configuration makes of it

Measure = Callable[[Subject, Outcome], Mapping[str, Value]]


@dataclass(frozen=True)
class Configuration(Generic[Subject, Outcome]):
    """One configuration of an experiment: a function of a prepared subject and a seed."""

    run: Callable[[Subject, int], Outcome]
    """Of a prepared subject and a seed."""

    group: str = ""
    """What it varies; configurations of a group share a colour of the plot."""

    settings: object = None
    """Everything else its values depend on, compared by its `repr`."""


@dataclass(frozen=True)
class Experiment(Generic[Subject, Outcome]):
    """What is measured of what."""

    name: str
    """As in `matcap bench NAME`."""

    subjects: Mapping[str, Callable[[], Subject]]
    """By name, each with what prepares it; called only where something of it is left to do."""

    configurations: Mapping[str, Configuration[Subject, Outcome]]
    """By name."""

    measures: Sequence[Measure[Subject, Outcome]]
    """In the order of their columns; `seconds` that the configuration took stands before them."""

    seeds: Sequence[int] = (0,)
    """Of the configurations."""

    skips: Callable[[str, str], bool] = field(default=lambda _subject, _configuration: False)
    """Whether a subject is not asked of a configuration."""

    settings: object = None
    """Everything else its values depend on, compared by its `repr`."""

    any_version: bool = False
    """Rows that another version of the source measured count: of sweeps that take hours."""

    def version(self, configuration: str) -> str:
        """Eight hexadecimal digits of matcap's source and a configuration's settings."""
        source = "" if self.any_version else source_version()
        identity = f"{source}{self.settings!r}{self.configurations[configuration].settings!r}"
        return hashlib.sha256(identity.encode()).hexdigest()[:8]


def run(
    experiment: Experiment[Subject, Outcome],
    table: Path,
    on_progress: Callable[[str], None] = lambda _line: None,
) -> list[Trial]:
    """Measure what the table lacks, row by row, and give the experiment's rows of it.

    A row that is there is not measured again while matcap's source and the experiment's settings
    are the same. What cannot be captured is reported by `on_progress` and left out.

    Raises:
        UsageError: a subject or a configuration was asked for what cannot be.
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
        raise MatcapError("nothing could be measured", where=str(table), remedy="see why above")
    return available


def choose(known: Mapping[str, Outcome], names: Sequence[str]) -> dict[str, Outcome]:
    """Those of these names; all without any.

    Raises:
        UsageError: there is none of a name.
    """
    for name in names:
        if name not in known:
            remedy = f"choose from {', '.join(known)}"
            raise UsageError("there is none of this name", where=name, remedy=remedy)
    return {name: known[name] for name in names or known}


@cache
def source_version() -> str:
    """Of the package's files, networks included."""
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
    for measure in experiment.measures:
        values.update(measure(prepared, outcome))
    return values
