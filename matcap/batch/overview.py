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
    state = _shown_state(row)
    tilt = None
    if row["tilt_x"] is not None:
        tilt = math.hypot(row["tilt_x"], row["tilt_y"])
    remarks = [row["reason"]] if row["reason"] else []
    remarks += [*row["warnings"], *row["notes"]]
    listed = "".join(f"<li>{html.escape(text)}</li>" for text in remarks)
    return "".join(
        [
            f'<tr class="{state.replace(" ", "-")}">',
            _name_cell(row),
            f'<td data-label="State" data-key="{state}"><span class=state>{state}</span></td>',
            f'<td data-label="Pictures" class=pictures><div>{_figures(row, pictures)}</div></td>',
            _verdict_cell(row),
            _number("Tilt", tilt, "{:.1f}°".format),
            _number("Clipped", row["clipped"], "{:.1%}".format),
            _number("Time", row["seconds"], spoken_duration),
            f'<td data-label="Remarks" data-key="{len(remarks)}"><ul>{listed}</ul></td>',
            "</tr>",
        ]
    )


def _shown_state(row: dict[str, Any]) -> str:
    """The state shown: a material that was made with verdict "failed" counts as failed."""
    if row["state"] != "done":
        return str(row["state"])
    if row["verdict"] == "failed":
        return "failed"
    return "doubtful" if row["doubtful"] else "done"


def _verdict_cell(row: dict[str, Any]) -> str:
    if row["verdict"] is None:
        return '<td data-label="Verdict" data-key="">&ndash;</td>'
    word, name = html.escape(row["verdict"]), quote(row["name"])
    command = html.escape(f"matcap view {shlex.quote('./' + row['name'])}")
    return (
        f'<td data-label="Verdict" data-key="{row["severity"]}">'
        f'<a class="verdict {word}" href="{name}/report.json">{word}</a>'
        f'<small><a href="{name}/">maps</a></small>'
        f"<details><summary>view</summary><code>{command}</code></details></td>"
    )


def _name_cell(row: dict[str, Any]) -> str:
    name = html.escape(row["name"])
    inside = name
    if row["state"] == "done":
        inside = f'<a href="{quote(row["name"])}/preview.png">{name}</a>'
    photos = ", ".join(html.escape(Path(photo).name) for photo in row["photographs"])
    key = html.escape(row["name"].casefold(), quote=True)
    return f'<th scope=row data-key="{key}">{inside}<small>{photos}</small></th>'


def _figures(row: dict[str, Any], pictures: dict[str, str]) -> str:
    name = html.escape(row["name"], quote=True)
    figures = []
    for label, data in pictures.items():
        word = html.escape(label.split(":")[0], quote=True)
        figures.append(
            f'<figure><img loading=lazy alt="{word} of {name}" title="{html.escape(label)}" '
            f'src="data:image/jpeg;base64,{html.escape(data, quote=True)}">'
            f"<figcaption>{word}</figcaption></figure>"
        )
    return "".join(figures)


def _number(label: str, value: float | None, say: Callable[[float], str]) -> str:
    key, text = ("", "&ndash;") if value is None else (value, say(value))
    return f'<td data-label="{label}" data-key="{key}" class=number>{text}</td>'
