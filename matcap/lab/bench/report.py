"""`matcap bench report`: docs/notes/accuracy-and-time.md from the tables that the benches wrote.

A CSV gets a section and a picture beside it; the JSON of `matcap bench relight` a table.
"""

from __future__ import annotations

import json
import math
import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matcap.errors import MatcapError
from matcap.files.staging import staged_file
from matcap.lab.bench.plot import draw
from matcap.lab.bench.table import Measurement, Point, comparable, front, points, read

_TITLES = {
    "capture": "Captures",
    "step": "One step of fine-tuning, beside the paper's form",
    "synth": "Synthesis",
    "relight": "Relighting",
}
_ERRORS = {
    "capture": "style error under new lights, in floors",
    "step": "",
    "synth": "largest difference from float32",
    "relight": "largest difference from all effects",
}
_WORDS = {
    "capture": (
        "Error of relit realisations against other true pieces of the same material, in multiples "
        "of the floor (what true pieces differ by), under lights away from the flash; *flash*: the "
        "same under the photograph's own light; *diversity*: how far two realisations are apart "
        "as a share of what two true pieces are. Seconds of processor time (on one thread those "
        "of the clock, at rest) from opening the file to the saved material, without importing; "
        "*spread* over subjects, *scatter* over seeds; memory is the process's, libraries "
        "included. Points of another detail are judged at it, by another floor, and are not on the "
        "front."
    ),
    "step": (
        "Forward, backward and the optimiser's step on 512 x 384 texels. The paper's form is its "
        "decoder (width 32) with the filter bank in place of VGG-19; with VGG-19 such a step was "
        "measured at 3.7 s and 3.4 GB on two cores."
    ),
    "synth": "",
    "relight": "",
}


def write_report(tables: Sequence[Path], page: Path, command: Sequence[str]) -> str:
    """Write the page, and a picture beside every CSV; gives the page's text.

    Args:
        tables: CSV files of benches, and JSON files of `matcap bench relight`.
        page: where the text goes.
        command: that is writing it, for the page to tell.

    Raises:
        MatcapError: a table cannot be read or holds nothing, matplotlib is missing, or a file
            cannot be written.
    """
    lines = ["# What accuracy costs in time", "", "Written by:", "", f"    {shlex.join(command)}"]
    for table in tables:
        if not table.is_file():
            raise MatcapError("there is no such table", where=str(table), remedy="measure first")
        if table.suffix == ".json":
            lines += ["", *_relighting(table)]
            continue
        measured = read(table)
        if not measured:
            raise MatcapError("the table is empty", where=str(table), remedy="measure first")
        for bench in dict.fromkeys(one.bench for one in measured):
            lines += ["", *_section(bench, [m for m in measured if m.bench == bench], table, page)]
    text = "\n".join(lines) + "\n"
    with staged_file(page) as file:
        file.write_text(text, encoding="utf-8")
    return text


def _section(bench: str, measured: Sequence[Measurement], table: Path, page: Path) -> list[str]:
    found = points(measured)
    machines = "; ".join(dict.fromkeys(one.machine for one in measured if one.machine))
    heading = _TITLES.get(bench, bench)
    if bench == "capture" and table.stem != bench:
        heading += f", {table.stem.replace('-', ' ')} materials"
    lines = [f"## {heading}", "", f"On {machines}.", ""] if machines else [f"## {heading}", ""]
    if _WORDS.get(bench):
        lines += [_WORDS[bench], ""]
    if bench == "step":
        return lines + _steps(found)
    picture = table.with_name(f"{table.stem}.png")
    subjects = len({one.subject for one in measured})
    draw(
        found,
        picture,
        title=f"{heading}: {len(found)} points over {subjects} subjects",
        error=_ERRORS.get(bench, "error"),
    )
    where = os.path.relpath(picture, page.parent)
    numbers = os.path.relpath(table, page.parent)
    lines += [f"![{_ERRORS.get(bench, 'error')} against seconds]({where})", ""]
    lines += [f"Every measurement: [{numbers}]({numbers}). On the Pareto front: *.", ""]
    lines += _table(found)
    verdicts = list(_presets(found))
    return lines + (["", *verdicts] if verdicts else [])


def _table(found: Sequence[Point]) -> list[str]:
    best = front(found)
    whole = any(not math.isnan(point.flash) for point in found)
    seeds = any(point.seeds > 1 for point in found)
    heads = ["", "varied", "point", "subjects", "seconds", "MB", "error", "spread"]
    heads += ["scatter"] if seeds else []
    heads += ["flash", "diversity"] if whole else []
    lines = [f"| {' | '.join(heads)} |", "|---|---|---|" + "---:|" * (len(heads) - 3)]
    for point in sorted(found, key=lambda point: point.seconds):
        cells = ["*" if point in best else "", point.group, point.name, str(point.subjects)]
        cells += [_number(point.seconds), _number(point.megabytes)]
        cells += [_number(point.error), _number(point.spread)]
        cells += [_number(point.scatter)] if seeds else []
        cells += [_number(point.flash), _number(point.diversity)] if whole else []
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _presets(found: Sequence[Point]) -> list[str]:
    """A line for each preset: on the front, or what is both as fast and better."""
    lines = []
    others = comparable(found)
    for preset in (point for point in found if point.group == "preset"):
        better = [
            point.name
            for point in others
            if point.seconds <= preset.seconds and point.error < preset.error
        ]
        says = f"dominated by {', '.join(better)}" if better else "dominated by no other point"
        lines.append(f"- preset `{preset.name}`: {says}.")
    return lines


def _steps(found: Sequence[Point]) -> list[str]:
    lines = ["| form | seconds a step | MB |", "|---|---:|---:|"]
    lines += [f"| {p.name} | {_number(p.seconds)} | {_number(p.megabytes)} |" for p in found]
    return lines


def _relighting(table: Path) -> list[str]:
    """The table of a JSON file of `matcap bench relight`."""
    try:
        told: dict[str, Any] = json.loads(table.read_text(encoding="utf-8"))
        scenes = [
            f"| {one['scene']} | {one['effects']} | {one['automatic_s']:.3f} | {one['all_s']:.3f} "
            f"| {one['ratio']:.1f} |"
            for one in told["scenes"]
        ]
        flat = (
            f"One megapixel, one point light, flat: {told['megapixel_wall_ms']:.0f} ms. The plan "
            "leaves out what changes less than half an 8-bit step, and is "
            f"{told['median_ratio']:.1f} times as fast as all effects in the median scene."
        )
    except (KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        raise MatcapError(
            f"this is not what matcap bench relight --json prints ({error})",
            where=str(table),
            remedy="measure again",
        ) from error
    heads = "| scene | effects run | seconds by plan | seconds by all | ratio |"
    return [f"## {_TITLES['relight']}", "", flat, "", heads, "|---|---:|---:|---:|---:|", *scenes]


def _number(value: float) -> str:
    if math.isnan(value):
        return ""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
