"""Validation of a map set's JSON document, for every reader.

The file is not trusted: every entry has a type and a range, and file names must be plain. Errors
name key and value. Provenance is free-form, but for the lengths that commands compute with
(known_provenance, also used for material files). folder.py reads and writes the documents.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from matcap.errors import MatcapError
from matcap.files.names import name_fault, shown
from matcap.files.settings import bounded, whole

NormalStyle = Literal["gl", "dx"]
NormalSource = Literal["height", "file"]
_STYLES: tuple[NormalStyle, ...] = ("gl", "dx")
_LONGEST_SIDE = 2**31 - 1  # texels, of an OpenEXR file
_MOST_UNIT = 1e9  # largest plane unit, in millimetres
SCALE = "millimetres_per_unit"
# Key of the number of F0's channels, 3 if coloured; absent for 1.
SPECULAR_CHANNELS = "specular_channels"


@dataclass(frozen=True)
class StatedMaps:
    """The checked entries of a map set's document."""

    name: str
    """Name of the set, a plain file name."""
    size: tuple[int, int]
    """(width, height) in texels."""
    texel_size: float
    """A texel's side in plane units."""
    height_scale: float
    """One unit of the height file, in plane units."""
    periodic: bool
    """Whether the maps tile seamlessly."""
    normal: NormalStyle
    """Direction of green in the normal map: "gl" up, "dx" down."""
    channels: Mapping[str, int]
    """Number of channels by map."""
    files: Mapping[str, tuple[str, tuple[str, ...] | None]]
    """File name by map, with its channels' names where several maps share a file."""
    provenance: dict[str, Any]
    """Record of how the material was made; its numbers are finite."""


def stated_maps(document: Mapping[str, Any], kinds: Mapping[str, int], file: Path) -> StatedMaps:
    """Check the document of a map set.

    Args:
        document: parsed JSON, of known format and version.
        kinds: number of channels by map, with F0 not coloured.
        file: path of the document, for errors.

    Raises:
        MatcapError: an entry is missing, of another type or out of range.
    """

    def entry(key: str, default: Any = ...) -> Any:  # noqa: ANN401
        value = document.get(key, default)
        if value is ...:
            raise ValueError(f"'{key}' is missing")
        return value

    try:
        maps = entry("maps")
        if not isinstance(maps, dict):
            raise ValueError(f"'maps' is {shown(maps)}, no list of maps")
        channels = {**kinds, "specular": stated_specular(document)}
        period = entry("periodic")
        if not isinstance(period, bool):
            raise ValueError(f"'periodic' is {shown(period)}, neither true nor false")
        return StatedMaps(
            name=_plain("name", entry("name", file.stem)),
            size=(
                whole(entry("width"), "'width'", 1, _LONGEST_SIDE),
                whole(entry("height"), "'height'", 1, _LONGEST_SIDE),
            ),
            texel_size=bounded(entry("texel_size"), "'texel_size'", 1e-9, 1e3),
            height_scale=bounded(entry("height_scale", 1.0), "'height_scale'", 1e-9, 1e9),
            periodic=period,
            normal=_style(entry("normal", "gl")),
            channels=channels,
            files={kind: _file(maps, kind, count) for kind, count in channels.items()},
            provenance=known_provenance(entry("provenance", None) or {}),
        )
    except (TypeError, ValueError, OverflowError) as error:
        raise MatcapError.at(
            file, f"the map set's description is damaged: {error}", "write the map set again"
        ) from error


def stated_specular(document: Mapping[str, Any]) -> int:
    """Number of F0's channels that a document states: 1 or 3, by default 1.

    Raises:
        ValueError: anything else.
    """
    count = document.get(SPECULAR_CHANNELS, 1)
    if isinstance(count, bool) or count not in (1, 3):
        raise ValueError(f"'{SPECULAR_CHANNELS}' is {shown(count)}, neither 1 nor 3")
    return int(count)


def known_provenance(stated: object) -> dict[str, Any]:
    """Check a file's provenance; numbers that are not finite become None.

    Raises:
        ValueError: not a JSON object, or a `millimetres_per_unit` out of range.
    """
    if not isinstance(stated, dict):
        raise ValueError(f"'provenance' is {shown(stated)}, no object")
    card = stated.get("card")
    for place in (stated, card if isinstance(card, dict) else {}):
        if place.get(SCALE) is not None:
            bounded(place[SCALE], f"'{SCALE}'", 1e-9, _MOST_UNIT)
    return _finite(stated)


def _finite(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, dict):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(key: str, value: object) -> str:
    wrong = name_fault(value)
    if wrong:
        raise ValueError(f"'{key}' is {shown(value)}, which {wrong}")
    return str(value)


def _style(value: object) -> NormalStyle:
    for style in _STYLES:
        if value == style:
            return style
    raise ValueError(f"'normal' is {shown(value)}, neither 'gl' nor 'dx'")


def _file(maps: dict[str, Any], kind: str, count: int) -> tuple[str, tuple[str, ...] | None]:
    about = maps.get(kind)
    if not isinstance(about, dict) or "file" not in about:
        raise ValueError(f"'maps' names no file of '{kind}'")
    channels = about.get("channels")
    if channels is not None and not (
        isinstance(channels, list)
        and len(channels) == count
        and all(isinstance(one, str) for one in channels)
    ):
        raise ValueError(f"the channels of '{kind}' are {shown(channels)}")
    return _plain(f"file of {kind}", about["file"]), None if channels is None else tuple(channels)
