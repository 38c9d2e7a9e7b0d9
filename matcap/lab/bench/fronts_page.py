"""What the fronts came to, as a section of docs/notes/accuracy-and-time.md."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from matcap.errors import MatcapError
from matcap.files.note import note
from matcap.lab.bench.fronts_plot import draw_fronts
from matcap.lab.bench.table import Measurement, Point, front, points, read
from matcap.lab.bench.ways import BASE, WAYS, preset_points
from matcap.lab.simulate.examples import EXAMPLES

_MEASURES = {
    "error": "SqueezeNet",
    "fine": "SqueezeNet, fine",
    "flash": "SqueezeNet, own flash",
    "patches": "patches",
    "filters": "filters",
}
_WORDS = (
    "*Floors*: how far what is read from the material is from other true pieces of the same, under "
    "lights away from the flash, in multiples of what true pieces differ by; 1 is "
    "indistinguishable. By SqueezeNet, which nothing is tuned by, unless another measure is named; "
    "*patches*: sliced Wasserstein distance of patches of 3, 7 and 15 texels at three scales; "
    "*filters*: random filters, statistics of the kind that decoders are tuned by. *Field* is the "
    "endless material, *piece* the photographed piece as it lies, *flash* the field under the "
    "photograph's own light, *fine* the field on 1024 texels across, where the others are judged "
    "on 512 and see nothing finer. Seconds of the processor and memory are of the whole command, "
    "libraries included, on one thread; seconds by the clock were taken while other programs ran, "
    "and count for little. A point measured on fewer materials is told by its ratio to `standard` "
    "on the same ones; *over seeds* is the standard deviation between seeds, its mean over "
    "materials."
)
_WORST = 10
_APART = 1.1  # of errors: less is as far as seeds scatter
_SHEETS_OF = "leather"
_FIVE = ("1024 texels, 5 photographs", "512 texels, 5 photographs")


def fronts_section(table: Path, page: Path) -> list[str]:
    """The section's lines, and a picture beside the table.

    Args:
        table: that `matcap bench fronts` wrote; its sheets lie beside it.
        page: that the section is for, to tell where the picture is.

    Raises:
        MatcapError: the table cannot be read or is empty; matplotlib is missing.
    """
    measured = [one for one in read(table) if one.bench == "capture"]
    if not measured:
        raise MatcapError("the table is empty", where=str(table), remedy="measure first")
    # Other photographs than the rest, which nothing of the others can be compared with.
    large = [one for one in measured if WAYS[one.point].pixels]
    usual = [one for one in measured if one not in large] or measured
    found, presets = points(usual, BASE), preset_points()
    picture = table.with_suffix(".png")
    folder = table.parent / "sheets" / _SHEETS_OF
    sheets = {sheet.stem: sheet for sheet in sorted(folder.glob("*.png"))}
    if not sheets:
        note(
            f"no sheets lie in {folder}, so {picture} shows none: copy them from the bench's folder"
        )
    draw_fronts(
        found,
        presets,
        picture,
        title="What accuracy costs: more photographs buy what more work on one cannot",
        sheets=sheets,
    )
    machines = "; ".join(dict.fromkeys(one.machine for one in measured if one.machine))
    subjects = list(dict.fromkeys(one.subject for one in measured))
    where, numbers = (os.path.relpath(path, page.parent) for path in (picture, table))
    return [
        "## Captures", "",
        f"{len(measured)} captures of {len(subjects)} materials. On {machines}.", "", _WORDS, "",
        f"![floors against seconds, with what one sees along the front]({where})", "",
        f"Every measurement: [{numbers}]({numbers}). On the front: *. Presets by their names.", "",
        *_table(found, presets), "",
        *_dominance(found, presets), "",
        *_of_large_photographs(large),
        "### By material", "", *_by_material(measured), "",
        "### The ten worst", "", *_worst(measured), "",
        "### Where the measures disagree", "", *_disagreements(found), "",
        *_eyes(table, page, measured),
    ]  # fmt: skip


def _table(found: Sequence[Point], presets: Mapping[str, str]) -> list[str]:
    best = front(found)
    heads = ["", "point", "preset", "materials", "processor s", "clock s", "MB", "field", "piece",
             "fine", "flash", "patches", "filters", "over seeds"]  # fmt: skip
    lines = [f"| {' | '.join(heads)} |", "|---|---|---|" + "---:|" * (len(heads) - 3)]
    for point in sorted(found, key=lambda point: point.seconds):
        cells = ["*" if point in best else "", point.name, presets.get(point.name, "")]
        cells += [str(point.subjects), *map(_number, (point.seconds, point.clock, point.megabytes))]
        cells += [_floors(v) for v in (point.error, point.piece, point.fine, point.flash)]
        cells += [_floors(v) for v in (point.patches, point.filters, point.scatter)]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _dominance(found: Sequence[Point], presets: Mapping[str, str]) -> list[str]:
    """A line for each preset: what of one photograph is as fast and better, if anything is."""
    of_one = [point for point in found if WAYS[point.name].photographs == 1]
    lines = []
    for point in (each for each in found if each.name in presets):
        better = [
            each.name
            for each in of_one
            if each.seconds <= point.seconds and each.error < point.error
        ]
        says = (
            f"dominated by {', '.join(better)}"
            if better
            else "dominated by no other point of one photograph"
        )
        lines.append(f"- preset `{presets[point.name]}` ({point.name}): {says}.")
    return lines


def _of_large_photographs(measured: Sequence[Measurement]) -> list[str]:
    """What finer detail costs and buys, of photographs that have it."""
    if not measured:
        return []
    lines = [
        "### Detail, of large photographs", "",
        "*Fine* is judged on 2048 texels across, here.", "",
        "| material | point | processor s | MB | field | piece | fine | flash |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]  # fmt: skip
    for one in measured:
        cells = [one.subject, one.point, _number(one.seconds), _number(one.megabytes)]
        cells += [_floors(v) for v in (one.error, one.piece, one.fine, one.flash)]
        lines.append(f"| {' | '.join(cells)} |")
    return [*lines, ""]


def _by_material(measured: Sequence[Measurement]) -> list[str]:
    """Floors of field and piece, one photograph and five, and means of both kinds of material."""
    known = {(one.point, one.subject): one for one in measured if one.seed == 0}
    five = next((name for name in _FIVE if any(point == name for point, _ in known)), None)
    columns = [BASE, *([five] if five else [])]
    subjects = [s for s in dict.fromkeys(one.subject for one in measured) if (BASE, s) in known]
    lines = [f"| material | {' | '.join(f'{name}: field | piece' for name in columns)} |"]
    lines += ["|---|" + "---:|---:|" * len(columns)]
    groups = {
        "named": [s for s in subjects if s in EXAMPLES],
        "real sets": [s for s in subjects if s not in EXAMPLES],
    }

    def cells(chosen: Sequence[str]) -> str:
        told = []
        for name in columns:
            ones = [known[name, s] for s in chosen if (name, s) in known]
            told += [_floors(_mean(one.error for one in ones))]
            told += [_floors(_mean(one.piece for one in ones))]
        return " | ".join(told)

    lines += [f"| {s} | {cells([s])} |" for s in (*groups["named"], *groups["real sets"])]
    return lines + [f"| **mean of {name}** | {cells(of)} |" for name, of in groups.items() if of]


def _worst(measured: Sequence[Measurement]) -> list[str]:
    """The worst of `standard`, what was said of them, and what five photographs make of them."""
    ones = [one for one in measured if one.point == BASE and one.seed == 0]
    # On the finer texels, where they were measured on both.
    five = {
        one.subject: one
        for point in reversed(_FIVE)
        for one in measured
        if one.point == point and one.seed == 0
    }
    heads = ["material", "field", "piece", "`inspect`", "verdict", "of five photographs"]
    lines = [f"| {' | '.join(heads)} |", "|---|---:|---:|---|---|---|"]
    for one in sorted(ones, key=lambda one: -one.error)[:_WORST]:
        other = five.get(one.subject)
        told = f"{other.error:.2f}, {other.piece:.2f}; {other.verdict}" if other else ""
        lines.append(
            f"| {one.subject} | {one.error:.2f} | {one.piece:.2f} | {one.seen} | {one.verdict} "
            f"| {told} |"
        )
    return lines


def _disagreements(found: Sequence[Point]) -> list[str]:
    """The front by every measure, one after the other."""
    lines = ["| by | the front, fastest first |", "|---|---|"]
    for name, called in _MEASURES.items():
        best: list[str] = []
        least = math.inf
        for point in sorted(found, key=lambda point: point.seconds):
            if getattr(point, name) < least:
                least = getattr(point, name)
                best.append(f"{point.name} ({least:.2f})")
        lines.append(f"| {called} | {', '.join(best)} |")
    return lines


def _eyes(table: Path, page: Path, measured: Sequence[Measurement]) -> list[str]:
    """How often each measure says what was written of pairs that were looked at without names."""
    path = table.with_name("pairs.csv")
    if not path.exists():
        return []
    known = {(one.subject, one.point, one.seed): one for one in measured}
    with path.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["nearer"] in ("left", "right")]
    looked = [
        (known[row["material"], row["left"], 0], known[row["material"], row["right"], 0], row)
        for row in rows
        if all((row["material"], row[side], 0) in known for side in ("left", "right"))
    ]
    where = os.path.relpath(path, page.parent)
    told = (
        "Pairs of two captures of one material beside the truth, looked at without names "
        f"([pairs.csv]({where})); in {len(looked)} of them one was nearer. How often each measure "
        f"says the same, of all, and of those that it tells {_APART - 1.0:.0%} apart and more:"
    )
    lines = ["### What eyes say", "", told, "", "| measure | agrees | | apart, agrees | |",
             "|---|---:|---:|---:|---:|"]  # fmt: skip
    for name, called in _MEASURES.items():
        both = [(getattr(a, name), getattr(b, name), row["nearer"]) for a, b, row in looked]
        both = [(a, b, nearer) for a, b, nearer in both if not math.isnan(a + b)]
        apart = [(a, b, nearer) for a, b, nearer in both if max(a, b) >= _APART * min(a, b)]
        lines.append(f"| {called} | {_agreed(both)} | {_agreed(apart)} |")
    return [*lines, ""]


def _agreed(pairs: Sequence[tuple[float, float, str]]) -> str:
    """Cells: how many of how many, and the share."""
    count = sum((left < right) == (nearer == "left") for left, right, nearer in pairs)
    return f"{count} of {len(pairs)} | {count / max(len(pairs), 1):.0%}"


def _mean(values: Iterable[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan


def _floors(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def _number(value: float) -> str:
    if math.isnan(value):
        return ""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
