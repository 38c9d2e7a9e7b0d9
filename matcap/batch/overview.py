"""index.html and index.json of an output folder: all materials and failed samples."""

from __future__ import annotations

import html
import json
import math
import shlex
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from matcap.batch.work import BatchEntry, read_record
from matcap.files.output import Output
from matcap.files.settings import spoken_duration

_STATES = {
    "made": "done", "kept": "done", "failed": "failed", "left": "not begun", "todo": "not begun",
}  # fmt: skip


_NOTHING = "&ndash;"


def write_index(out: Path, entries: Sequence[BatchEntry]) -> None:
    """Write both files, all or none; they also list materials of earlier batches.

    Raises:
        MatcapError: a full disk, an unwritable folder.
    """
    rows, pictures = _rows(out, entries)
    with Output(out).stage() as stage:
        document = {"format": "matcap batch index", "version": 1, "materials": rows}
        (stage / "index.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n")
        (stage / "index.html").write_text(page(rows, pictures), encoding="utf-8")


def page(rows: Sequence[dict[str, Any]], pictures: Sequence[dict[str, str]]) -> str:
    """The self-contained HTML page.

    Args:
        rows: as in index.json.
        pictures: base64 JPEGs by label, a dictionary a row.
    """
    done = sum(row["state"] == "done" for row in rows)
    failed, doubtful = (
        sum(_shown_state(row) == state for row in rows) for state in ("failed", "doubtful")
    )
    seconds = sum(row["seconds"] or 0.0 for row in rows)
    counts = [f"{done} of {len(rows)} done", f"{doubtful} doubtful", f"{failed} failed"]
    counts.append(f"{spoken_duration(seconds)} of work")
    body = "\n".join(_row(row, shown) for row, shown in zip(rows, pictures, strict=True))
    template = (files("matcap.batch") / "index.html").read_text(encoding="utf-8")
    return template.replace("@SUMMARY@", html.escape(" · ".join(counts))).replace("@ROWS@", body)


def _rows(
    out: Path, entries: Sequence[BatchEntry]
) -> tuple[list[dict[str, Any]], list[dict[str, str]]]:
    rows, pictures = [], []
    for entry in entries:
        row = _row_of(entry.record, _STATES[entry.state], entry.sample.name)
        photographs = [str(path) for path in entry.sample.photos]
        rows.append(row | {"photographs": photographs, "reason": entry.reason})
        pictures.append(_pictures(read_record(out / entry.sample.name) or {}))
    names = {entry.sample.name for entry in entries}
    for folder in sorted(out.iterdir()):
        record = read_record(folder) if folder.name not in names else None
        if record is not None:
            rows.append(_row_of(record, "done", folder.name))
            pictures.append(_pictures(record))
    return rows, pictures


def _row_of(record: dict[str, Any], state: str, name: str) -> dict[str, Any]:
    tilt = record.get("tilt_degrees") or (None, None)
    verdict = record.get("verdict") or {}
    error = record.get("error") or {}
    return {
        "name": name,
        "state": state,
        "photographs": record.get("photographs", []),
        "verdict": verdict.get("rating"),
        "severity": verdict.get("severity"),
        "exemplar_error": error.get("exemplar", error.get("piece")),
        "field_error": error.get("field"),
        "tilt_x": tilt[0],
        "tilt_y": tilt[1],
        "clipped": record.get("clipped"),
        "doubtful": record.get("doubtful", False),
        "seconds": record.get("seconds"),
        "detail": record.get("detail"),
        "warnings": list(record.get("warnings", [])),
        "notes": list(record.get("notes", [])),  # of reading the file
        "reason": "",
    }


def _pictures(record: dict[str, Any]) -> dict[str, str]:
    thumbnails = record.get("thumbnails")
    return dict(thumbnails) if isinstance(thumbnails, dict) else {}


def _row(row: dict[str, Any], pictures: dict[str, str]) -> str:
    state, tilt = _shown_state(row), None
    if row["tilt_x"] is not None:
        tilt = math.hypot(row["tilt_x"], row["tilt_y"])
    remarks = [*([row["reason"]] if row["reason"] else []), *row["warnings"], *row["notes"]]
    listed = "".join(f"<li>{html.escape(text)}</li>" for text in remarks)
    cells = (
        _name_cell(row),
        _cell("State", state, f"<span class=state>{state}</span>"),
        _cell("Pictures", None, f"<div>{_figures(row['name'], pictures)}</div>", " class=pictures"),
        _cell("Verdict", row["severity"] if row["verdict"] else "", _verdict(row)),
        _number("Tilt", tilt, "{:.1f}°".format),
        _number("Clipped", row["clipped"], lambda share: f"{100.0 * share:.1f} %"),
        _number("Time", row["seconds"], spoken_duration),
        _cell("Remarks", len(remarks), f"<ul>{listed}</ul>"),
    )
    return f'<tr class="{state.replace(" ", "-")}">{"".join(cells)}</tr>'


def _cell(label: str, key: object, inside: str, more: str = "") -> str:
    """A cell that is sorted by its key, if it has one."""
    sorted_by = "" if key is None else f' data-key="{key}"'
    return f'<td data-label="{label}"{sorted_by}{more}>{inside}</td>'


def _number(label: str, value: float | None, say: Callable[[float], str]) -> str:
    key, text = ("", _NOTHING) if value is None else (value, say(value))
    return _cell(label, key, text, " class=number")


def _shown_state(row: dict[str, Any]) -> str:
    """The state shown: a material that was made with verdict "failed" counts as failed."""
    if row["state"] != "done":
        return str(row["state"])
    if row["verdict"] == "failed":
        return "failed"
    return "doubtful" if row["doubtful"] else "done"


def _verdict(row: dict[str, Any]) -> str:
    if row["verdict"] is None:
        return _NOTHING
    word, name = html.escape(row["verdict"]), quote(row["name"])
    command = html.escape(f"matcap view {shlex.quote('./' + row['name'])}")
    return (
        f'<a class="verdict {word}" href="{name}/report.json">{word}</a>'
        f'<small><a href="{name}/">maps</a></small>'
        f"<details><summary>view</summary><code>{command}</code></details>"
    )


def _name_cell(row: dict[str, Any]) -> str:
    name = inside = html.escape(row["name"])
    if row["state"] == "done":
        inside = f'<a href="{quote(row["name"])}/preview.png">{name}</a>'
    photos = ", ".join(html.escape(Path(photo).name) for photo in row["photographs"])
    key = html.escape(row["name"].casefold(), quote=True)
    return f'<th scope=row data-key="{key}">{inside}<small>{photos}</small></th>'


def _figures(name: str, pictures: dict[str, str]) -> str:
    return "".join(
        f'<figure><img loading=lazy alt="{html.escape(label.split(":")[0], quote=True)} of '
        f'{html.escape(name, quote=True)}" title="{html.escape(label)}" '
        f'src="data:image/jpeg;base64,{html.escape(data, quote=True)}">'
        f"<figcaption>{html.escape(label.split(':')[0])}</figcaption></figure>"
        for label, data in pictures.items()
    )
