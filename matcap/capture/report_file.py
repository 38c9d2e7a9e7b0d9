"""Reading report.json; report.schema.json is its JSON Schema.

Format 1 had other names for some entries; what it says is read as format 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from matcap.files.document import read_document

FORMAT, VERSION = "matcap report", 2
# Entries that format 1 had under another name: where, old and new. "*" is every member.
_RENAMED = (
    ("", "several", "multi_view"),
    ("error", "piece", "exemplar"),
    ("effort", "places", "windows_per_step"),
    ("verdict.causes.*", "says", "message"),
    ("verdict.checks.*", "says", "message"),
    ("verdict.checks", "piece", "exemplar"),
    ("exemplar", "slow", "low_frequency_residual"),
    ("exemplar", "strengths", "relief_spectrum"),
    ("exemplar.relief_spectrum.bands.*", "waves", "wavelengths"),
    ("multi_view.photographs.*", "likeness", "correlation"),
    ("multi_view.photographs.*", "place", "position"),
    ("multi_view.photographs.*", "doubt", "position_deviation"),
    ("multi_view.photographs.*", "predicted", "leave_one_out_residual"),
    ("multi_view.left_out.*", "why", "reason"),
    ("multi_view", "union", "mosaic"),
    ("multi_view.mosaic", "times", "area_ratio"),
)


def read_report(file: Path) -> dict[str, Any] | None:
    """A capture's report as format 2; None if the file is missing, damaged or of a later format."""
    report = read_document(file, FORMAT)
    version = 1 if report is None else report.get("version", 1)
    if report is None or version not in (1, VERSION):
        return None
    for where, old, new in _RENAMED if version == 1 else ():
        for entry in _members(report, where.split(".") if where else []):
            if old in entry:
                entry[new] = entry.pop(old)
    return report | {"version": VERSION}


def _members(document: object, path: list[str]) -> Iterator[dict[str, Any]]:
    """The objects at a path, as far as it is there."""
    if not path:
        if isinstance(document, dict):
            yield document
    elif path[0] == "*":
        inside = document.values() if isinstance(document, dict) else document
        for one in inside if not isinstance(inside, str) and hasattr(inside, "__iter__") else ():
            yield from _members(one, path[1:])
    elif isinstance(document, dict):
        yield from _members(document.get(path[0]), path[1:])
