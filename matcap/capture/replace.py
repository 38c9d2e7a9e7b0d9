"""Overwrite rule: an existing capture is replaced only by the same or a higher preset."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matcap.capture.outputs import REPORT
from matcap.capture.report_file import read_report
from matcap.capture.settings import CaptureSettings, OutputSettings, resolve
from matcap.errors import MatcapError
from matcap.files.document import read_document

# Settings that determine only the effort; the resulting effort is compared instead.
_HOW_LONG = ("preset", "steps", "time_limit")


def refuse_to_replace_capture(
    folder: Path,
    photographs: Sequence[Path],
    settings: CaptureSettings,
    outputs: OutputSettings,
) -> None:
    """Raise if a folder has a capture of another photograph, other settings or more effort.

    Args:
        folder: output folder of the new capture.
        photographs: its files; the first one's name is compared.
        settings: of the new capture.
        outputs: of the new capture.

    Raises:
        MatcapError: lists the differences and names --overwrite.
    """
    old = read_report(folder / REPORT)
    if old is None:
        return
    _refuse(folder, _differences(folder, old, photographs, settings, outputs))


def refuse_to_replace_longer_capture(
    folder: Path, settings: CaptureSettings, photographs: int
) -> None:
    """Raise if a folder has a capture of more photographs, texels or steps.

    Args:
        folder: output folder of the new capture.
        settings: of the new capture.
        photographs: number of its photographs.

    Raises:
        MatcapError: states the old effort and names --overwrite.
    """
    old = read_report(folder / REPORT)
    _refuse(folder, [] if old is None else _longer(old, settings, photographs))


def _refuse(folder: Path, differences: Sequence[str]) -> None:
    if differences:
        raise MatcapError.at(
            folder,
            f"the folder has an earlier capture ({', '.join(differences)})",
            "choose another folder with -o, or give --overwrite",
        )


def _longer(old: dict[str, Any], settings: CaptureSettings, photographs: int) -> list[str]:
    """One phrase if the earlier capture, not interrupted, had more photographs, texels or steps."""
    if old.get("interrupted"):
        return []
    before = len((old.get("multi_view") or {}).get("photographs", ())) or 1
    if before > photographs:
        return [f"one of {before} photographs"]
    spent, effort = old.get("effort", {}), resolve(settings)
    # `effort` may hold the preset's detail, so that `settings` comes first.
    detail = old.get("settings", {}).get("detail") or spent.get("detail", 0)
    if detail > effort.detail or spent.get("steps", 0) > effort.steps:
        return [f"a longer one, of preset {spent.get('preset')}"]
    return []


def _differences(
    folder: Path,
    old: dict[str, Any],
    photographs: Sequence[Path],
    settings: CaptureSettings,
    outputs: OutputSettings,
) -> list[str]:
    """Phrases that name how an earlier capture differs from the new one."""
    differences = []
    before = str(old.get("photograph", {}).get("name"))
    if before != photographs[0].name:
        differences.append(f"of {before}")
    named = {k: v for k, v in settings.named().items() if k not in _HOW_LONG}
    earlier = old.get("settings", {})
    differences += [
        f"{key.replace('_', '-')} {earlier[key]}"
        for key in named
        if key in earlier and earlier[key] != json.loads(json.dumps(named[key]))
    ]
    differences += _longer(old, settings, len(photographs))
    maps = read_document(folder / f"{folder.name}.json")
    if maps is not None:
        size = (maps.get("width"), maps.get("height"))
        if size != outputs.size:
            differences.append(f"with maps of {size[0]}x{size[1]}")
        if maps.get("seed") != outputs.seed:
            differences.append(f"with maps of seed {maps.get('seed')}")
        if "png" in maps and not outputs.png:
            differences.append("with PNGs")
    return differences
