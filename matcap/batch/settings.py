"""What a batch is to do: matcap.toml beside the shoot, and flags that win over it."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from matcap.capture.choices import CHOICES, Choice
from matcap.capture.outputs import OutputSettings
from matcap.capture.settings import CaptureSettings, Statistics
from matcap.errors import MatcapError, UsageError
from matcap.files import values

FILE = "matcap.toml"
_GROUPS = ("none", "name", "dir", "time")
_MOST_BYTES = 1_000_000  # of a settings file; nobody writes more


# What options and matcap.toml call otherwise than the captures' and the outputs' settings do.
_RENAMED = {"time": "time_limit", "export": "targets"}


@dataclass(frozen=True)
class BatchSettings:
    """Everything that can be set for a batch.

    Attributes:
        capture: of every sample.
        outputs: of every sample.
        group: "none", "name", "dir" or "time".
        gap: seconds between two photographs of one sample, where grouped by time.
        jobs: worker processes, or None for as many as cores and memory allow.
        card: a photograph of a calibration card, "auto" for the one in the shoot whose name begins
            with "card", or "none".
    """

    capture: CaptureSettings = CaptureSettings()
    outputs: OutputSettings = OutputSettings()
    group: str = "name"
    gap: float = 10.0
    jobs: int | None = None
    card: str = "auto"

    @staticmethod
    def of(named: Mapping[str, Any]) -> BatchSettings:
        """Settings by the names of options and of matcap.toml's keys; the rest as by default."""
        values = {_RENAMED.get(name, name): value for name, value in named.items()}

        def part(kind: type) -> dict[str, Any]:
            return {f.name: values[f.name] for f in fields(kind) if f.name in values}

        capture, outputs = part(CaptureSettings), part(OutputSettings)
        return BatchSettings(
            CaptureSettings.of(capture), OutputSettings(**outputs), **part(BatchSettings)
        )

    def named(self) -> dict[str, Any]:
        """All settings by the names of options; BatchSettings.of() of them is these again."""
        values = asdict(self) | asdict(self.outputs) | self.capture.named()
        del values["outputs"], values["capture"]
        return {_BACK.get(name, name): value for name, value in values.items()}


_KINDS = {
    str: "a text", int: "a whole number", float: "a number", bool: "true or false", list: "a list",
}  # fmt: skip
_BACK = {field: name for name, field in _RENAMED.items()}
_RULES: Mapping[str, Choice] = {
    **{_BACK.get(name, name): choice for name, choice in CHOICES.items()},
    "time": Choice((str, int, float), "Of each sample."),
    "size": Choice((str, int), "Of the first map sets."),
    "tile": Choice((bool,), "Map sets that repeat without a seam."),
    "png": Choice((bool,), "16-bit PNGs beside the EXR files."),
    "normal": Choice((str,), "Which way green points.", words=("gl", "dx")),
    "export": Choice((str, list, tuple), "Also for these renderers or engines."),
    "group": Choice((str,), "Which photographs show one sample.", words=_GROUPS),
    "gap": Choice((int, float), "Seconds between two shots, with group time.", 0.0, 1e9),
    "jobs": Choice((int,), "Workers.", 1, 1024),
    "card": Choice((str,), "Photograph of a calibration card."),
}


def settings_of(shoot: Path, flags: Mapping[str, Any]) -> BatchSettings:
    """matcap.toml of a shoot, where it has one, and flags over it.

    Args:
        shoot: the folder; its file lies in it or beside it, the one inside wins.
        flags: by name, None where the user gave none.

    Raises:
        UsageError: a file that is no TOML; a key or value that there is not, with the nearest.
    """
    file = settings_file(shoot)
    read = read_settings(file) if file else {}
    given = {name: value for name, value in flags.items() if value is not None}
    return BatchSettings.of(read | _checked(given, "the options"))


def settings_file(shoot: Path) -> Path | None:
    """The matcap.toml that holds for a shoot: in it, or beside it."""
    places = (shoot / FILE, shoot.resolve().parent / FILE)
    return next((file for file in places if file.is_file()), None)


def read_settings(file: Path) -> dict[str, Any]:
    """The keys that a matcap.toml sets, checked, as BatchSettings.of takes them.

    Paths in it are relative to it.

    Raises:
        UsageError: no TOML; an unknown key or a wrong value.
    """
    remedy = "correct it or take it away"
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise UsageError("the file is too large for settings", where=str(file), remedy=remedy)
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise UsageError(f"this is not TOML ({error})", where=str(file), remedy=remedy) from error
    except OSError as error:
        raise MatcapError(
            f"the settings cannot be read ({error.strerror})", where=str(file), remedy=remedy
        ) from error
    read = _checked(table, str(file))
    plainly = (("prior", ("auto", "none")), ("card", ("auto", "none")), ("mask", ()))
    for name, plain in plainly:
        if name in read and read[name] not in plain:
            read[name] = str(file.parent / read[name])
    statistics = read.get("statistics", Statistics())
    if statistics.weights is not None:
        read["statistics"] = replace(statistics, weights=file.parent / statistics.weights)
    return read


def _checked(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    checked = {}
    for key, value in table.items():
        name = key.replace("-", "_")
        if name not in _RULES:
            raise UsageError(
                f"there is no setting {_short(key)}", where=where, remedy=_nearest(name, _RULES)
            )
        checked[name] = _value(name, value, where)
    return checked


def _value(name: str, value: Any, where: str) -> Any:  # noqa: ANN401
    rule = _RULES[name]
    if name == "size" and isinstance(value, (tuple, list)):
        value = "x".join(str(part) for part in value)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    fits = isinstance(value, rule.kinds) and (bool in rule.kinds or not isinstance(value, bool))
    if not fits:
        kinds = " or ".join(_KINDS[kind] for kind in rule.kinds if kind in _KINDS)
        raise UsageError(f"{name} is {_short(value)}", where=where, remedy=f"give {kinds}")
    if rule.words and value not in rule.words:
        raise UsageError(
            f"there is no {name} {_short(value)}", where=where, remedy=_nearest(value, rule.words)
        )
    if number and not rule.fits(value):
        raise UsageError(
            f"{name} is {value:g}, out of range",
            where=where,
            remedy=f"give between {rule.least:g} and {rule.most:g}",
        )
    if name == "statistics":
        return Statistics.parse(value)
    if name == "export":
        names = [value] if isinstance(value, str) else [str(each) for each in value]
        return OutputSettings.known_targets(names, where)
    try:
        if name == "size":
            sides = values.size(str(value))
            return (sides.width, sides.height)
        if name == "time":
            return values.duration(str(value))
    except ValueError as error:
        raise UsageError(str(error), where=where, remedy=f"correct {name}") from error
    return float(value) if float in rule.kinds and number else value


def _nearest(name: str, known: Mapping[str, Any] | tuple[str, ...]) -> str:
    close = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    return f"the nearest is {close[0]!r}" if close else f"there are {', '.join(known)}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


assert set(_RULES) == set(BatchSettings().named()) | {"crop", "mask", "union"}
