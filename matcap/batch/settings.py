"""Settings of a batch: matcap.toml in or next to the input folder, overridden by options."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from matcap.capture.settings import CaptureSettings, OutputSettings, Statistics
from matcap.errors import MatcapError, UsageError
from matcap.files.settings import (
    CheckedSettings,
    Setting,
    nearest,
    setting,
    settings_in,
    typed_settings,
)

FILE = "matcap.toml"
_MOST_BYTES = 1_000_000  # limit of a settings file


@dataclass(frozen=True)
class BatchSettings(CheckedSettings):
    """Settings of a batch, and of the captures in it."""

    capture: CaptureSettings = CaptureSettings()
    """Settings of every capture."""
    outputs: OutputSettings = OutputSettings()
    """Settings of every capture's outputs."""
    group: str = setting("name", words=("none", "name", "dir", "time"))
    """Which photographs show one sample."""
    gap: float = setting(10.0, least=0.0, most=1e9)
    """Seconds between two shots of one sample, with group time."""
    jobs: int | None = setting(
        None, least=1, most=1024, short="-j", otherwise="as cores and memory allow"
    )
    """Worker processes."""
    card: str = setting("auto", metavar="auto|none|PATH")
    """Photograph of a calibration card; auto is the one in the folder whose name begins so."""

    @staticmethod
    def of(named: Mapping[str, Any]) -> BatchSettings:
        """Settings by name of a field, option or key of matcap.toml; others keep their defaults.

        Raises:
            UsageError: a value that the setting does not allow.
        """
        fields_by_name = {name: one.field for name, one in SETTINGS.items()}
        values = {fields_by_name.get(name, name): value for name, value in named.items()}

        def part(kind: type) -> dict[str, Any]:
            named = {f.name: values[f.name] for f in fields(kind) if f.name in values}
            return typed_settings(kind, named)

        return BatchSettings(
            CaptureSettings(**part(CaptureSettings)),
            OutputSettings(**part(OutputSettings)),
            **part(BatchSettings),
        )

    def named(self) -> dict[str, Any]:
        """All settings by the names of options: the inverse of of()."""
        values = asdict(self) | asdict(self.outputs) | self.capture.named()
        del values["outputs"], values["capture"]
        names = {one.field: name for name, one in SETTINGS.items()}
        return {names.get(name, name): value for name, value in values.items()}


# By name in options and matcap.toml.
SETTINGS: Mapping[str, Setting] = {
    one.name: one
    for kind in (OutputSettings, CaptureSettings, BatchSettings)
    for one in settings_in(kind).values()
}


def settings_of(source: Path, flags: Mapping[str, Any]) -> BatchSettings:
    """Settings of matcap.toml, where there is one, overridden by options.

    Args:
        source: the input folder; matcap.toml is in it, or else in its parent.
        flags: options by field, None where not given.

    Raises:
        UsageError: as read_settings.
    """
    places = (source / FILE, source.resolve().parent / FILE)
    file = next((file for file in places if file.is_file()), None)
    read = read_settings(file) if file else {}
    return BatchSettings.of(read | {name: v for name, v in flags.items() if v is not None})


def read_settings(file: Path) -> dict[str, Any]:
    """Read and check a matcap.toml: values by field. Its paths are relative to it.

    Raises:
        UsageError: not TOML; an unknown key, with the nearest known one; a value not allowed.
    """
    remedy = "correct it or remove it"
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise UsageError.at(file, "the file is too large for settings", remedy)
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise UsageError.at(file, f"this is not TOML ({error})", remedy) from error
    except OSError as error:
        raise MatcapError.at(
            file, f"the settings cannot be read ({error.strerror})", remedy
        ) from error
    read = {}
    for key, value in table.items():
        name = key.replace("-", "_")
        if name not in SETTINGS:
            raise UsageError.at(file, f"there is no setting {key[:60]!r}", nearest(name, SETTINGS))
        one = SETTINGS[name]
        read[one.field] = one.typed(value, f"{file}: {name}")
    plainly: tuple[tuple[str, tuple[str, ...]], ...] = (
        ("prior", ("auto", "none")), ("card", ("auto", "none")), ("mask", ()),
    )  # fmt: skip
    for name, plain in plainly:
        if name in read and read[name] not in plain:
            read[name] = type(read[name])(file.parent / read[name])
    statistics = read.get("statistics", Statistics())
    if statistics.weights is not None:
        read["statistics"] = replace(statistics, weights=file.parent / statistics.weights)
    return read
