"""Reads a training configuration: a TOML file with the names of TrainConfig."""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from matcap.errors import UsageError
from matcap.space.decoder import DecoderConfig
from matcap.space.encoder import BACKBONES, EncoderConfig
from matcap_lab.train.state import TrainConfig
from matcap_lab.train.step import fits

_Table = TypeVar("_Table", TrainConfig, EncoderConfig, DecoderConfig)


def read_toml(path: Path) -> dict[str, Any]:
    """Contents of a TOML file.

    Raises:
        UsageError: no such file, or no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"it cannot be read ({error.strerror})", where=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(
            f"it cannot be read: this is not TOML ({error})", where=str(path)
        ) from error


def read_config(path: Path) -> TrainConfig:
    """TrainConfig of a TOML file; missing settings keep their defaults.

    Raises:
        UsageError: no such file, no TOML, an unknown name or a value of the wrong kind.
    """
    return configured(read_toml(path), str(path))


def configured(stated: dict[str, Any], path: str) -> TrainConfig:
    """TrainConfig of the TOML contents `stated`; `path` is for messages. See read_config."""
    encoder = _filled(EncoderConfig(), stated.pop("encoder", {}), f"{path}, encoder")
    decoder = _filled(DecoderConfig(), stated.pop("decoder", {}), f"{path}, decoder")
    config = _filled(TrainConfig(), stated, path)
    if encoder.backbone not in BACKBONES:
        raise UsageError.at(
            path,
            f"there is no backbone '{encoder.backbone}'",
            f"choose from {', '.join(BACKBONES)}",
        )
    if not fits(config.window):
        raise UsageError.at(
            path, f"the window {config.window} is no multiple of 16 from 64 on", "give 96"
        )
    return replace(config, encoder=encoder, decoder=decoder)


def _filled(default: _Table, stated: dict[str, Any], where: str) -> _Table:
    """A frozen dataclass with some of its values replaced by those of a table."""
    values: dict[str, Any] = {}
    kinds = {f.name: type(getattr(default, f.name)) for f in fields(default)}
    for name, value in stated.items():
        if name not in kinds:
            known = ", ".join(kinds)
            raise UsageError.at(where, f"there is no setting '{name}'", f"use {known}")
        kind = kinds[name]
        if kind is float and type(value) is int:
            value = float(value)
        if kind is tuple and isinstance(value, list):
            value = tuple(value)
        if type(value) is not kind:
            raise UsageError.at(where, f"'{name}' is {value!r}", f"give a {kind.__name__}")
        values[name] = value
    return replace(default, **values)
