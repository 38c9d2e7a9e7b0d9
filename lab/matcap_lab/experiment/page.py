"""The results page: a section, a table and a plot for every CSV."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from matcap.errors import MatcapError
from matcap.files.output import Output
from matcap_lab.experiment.results import (
    Mean,
    Trial,
    columns_of,
    comparable,
    front,
    markdown,
    means,
    read,
    shown,
)

BY_HAND = "## What to make of it"


@dataclass(frozen=True)
class Presentation:
    """Title, columns and plot of an experiment's results."""

    title: str
    about: str
    """What was measured, and what each column means."""
    axes: tuple[str, str]
    """Columns of the plot and the Pareto front: cost, error."""
    base: str | None = None
    """Baseline: configurations measured on fewer subjects are given by their ratio to it
    (results.means), and its subjects are listed."""
    listed_with: tuple[str, ...] = ()
    """Further configurations in the table by subject."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Display names of configurations."""
    separate_groups: frozenset[str] = frozenset()
    """Groups measured on other subjects, hence compared only among themselves."""
    least: float | None = None
    """Lower limit of a logarithmic error axis; None for a linear one."""
    picture: bool = True
    """Whether a plot is drawn."""


def write_page(tables: Mapping[Path, Presentation], page: Path, command: str) -> str:
    """Write the page and a plot next to every CSV; returns the page's text.

    The existing page's text below `BY_HAND` is kept.

    Args:
        tables: CSVs that experiments wrote.
        page: the Markdown file.
        command: the command that writes the page, quoted on it.

    Raises:
        MatcapError: a table cannot be read or holds nothing, matplotlib is missing, or a file
            cannot be written.
    """
    lines = ["# What accuracy costs in time", "", "Written by:", "", f"    {command}"]
    for table, form in tables.items():
        lines += ["", *section(table, form, page)]
    before = page.read_text(encoding="utf-8") if page.exists() else ""
    _, kept, by_hand = before.partition(f"{BY_HAND}\n")
    text = "\n".join(lines).rstrip() + "\n" + (f"\n{kept}{by_hand}" if kept else "")
    with Output.file(page) as file:
        file.write_text(text, encoding="utf-8")
    return text


def section(table: Path, form: Presentation, page: Path) -> list[str]:
    """Markdown lines of a table's section; draws its plot next to the CSV.

    Raises:
        MatcapError: it cannot be read or is empty; matplotlib is missing.
    """
    rows = read(table)
    if not rows:
        raise MatcapError.at(table, "the table is missing or empty", "measure first")
    separate = [row for row in rows if row.group in form.separate_groups]
    usual = [row for row in rows if row.group not in form.separate_groups] or rows
    averages = means(usual, form.base)
    picture = table.with_suffix(".png")
    if form.picture:
        best = front(averages, *form.axes) if form.base else None
        draw(
            averages, picture, form.axes, form.title,
            labels=form.labels, least=form.least, best=best,
        )  # fmt: skip
    machines = "; ".join(dict.fromkeys(row.machine for row in rows if row.machine))
    subjects = len({row.subject for row in rows})
    where, numbers = (os.path.relpath(path, page.parent) for path in (picture, table))
    lines = [
        f"## {form.title}", "",
        f"{len(rows)} rows, {subjects} subjects.{f' On {machines}.' if machines else ''}", "",
        form.about, "",
        *([f"![{form.axes[1]} against {form.axes[0]}]({where})", ""] if form.picture else []),
        f"Every measurement: [{numbers}]({numbers}). Least {form.axes[0]} first; on the Pareto "
        "front: *.", "", *_means(averages, form), "",
    ]  # fmt: skip
    if form.base:
        lines += ["### By subject", "", *_by_subject(usual, form), ""]
    if separate and separate != usual:
        lines += [
            f"### {', '.join(sorted(form.separate_groups)).capitalize()}",
            "",
            *_each(separate),
            "",
        ]
    return lines


def _means(averages: Sequence[Mean], form: Presentation) -> list[str]:
    x, y = form.axes
    best = front(averages, x, y)
    columns = [c for c in averages[0].values if any(shown(mean[c]) for mean in averages)]
    scattered = any(mean.seeds > 1 for mean in averages)
    rows = []
    for mean in sorted(averages, key=lambda mean: mean[x]):
        called = form.labels.get(mean.configuration, "")
        cells = ["*" if mean in best else "", mean.configuration, called, str(mean.subjects)]
        cells += [shown(mean[column]) for column in columns]
        rows.append(cells + ([shown(mean.scatter[y])] if scattered else []))
    head = ["", "configuration", "", "subjects", *columns]
    return markdown(head + ([f"{y} over seeds"] if scattered else []), rows, 3)


def _by_subject(rows: Sequence[Trial], form: Presentation) -> list[str]:
    """Errors by subject of the baseline and of `listed_with`, the worst subjects first."""
    error = form.axes[1]
    names = [form.base, *form.listed_with]
    first = {(row.configuration, row.subject): row for row in rows if row.seed == 0}
    known = [row for (name, _), row in first.items() if name == form.base]
    worst = sorted(known, key=lambda row: -row.number(error))
    words = [c for c in columns_of(rows) if any(isinstance(r.values.get(c), str) for r in known)]
    lines = []
    for row in worst:
        of = [first.get((str(name), row.subject)) for name in names]
        cells = ["" if each is None else shown(each.number(error)) for each in of]
        lines.append([row.subject, *cells, *(shown(row.values.get(word, "")) for word in words)])
    return markdown(["subject", *map(str, names), *words], lines)


def _each(rows: Sequence[Trial]) -> list[str]:
    columns = [c for c in columns_of(rows) if any(shown(row.number(c)) for row in rows)]
    cells = [
        [r.subject, r.configuration, *(shown(r.number(column)) for column in columns)] for r in rows
    ]
    return markdown(["subject", "configuration", *columns], cells, 2)


# Plot of error against cost, for every experiment (extra `bench`: matplotlib).


def draw(
    averages: Sequence[Mean],
    path: Path,
    axes: tuple[str, str],
    title: str,
    *,
    labels: Mapping[str, str] = MappingProxyType({}),
    least: float | None = None,
    best: Sequence[Mean] | None = None,
) -> None:
    """Draw one column against another as a PNG, the Pareto front joined, numbered and listed.

    Args:
        averages: the means; whiskers show the spread over their subjects.
        path: of the picture.
        axes: columns along x (logarithmic) and y.
        title: above it.
        labels: names of configurations; those that are not on the front are listed too.
        least: lower limit of a logarithmic y axis; None for a linear one.
        best: the front; by default of the configurations measured on the most subjects.

    Raises:
        MatcapError: matplotlib is not installed, or the file cannot be written.
    """
    x, y = axes
    figure = new_figure((10.5, 5.6))
    plot = figure.add_subplot()
    for group in dict.fromkeys(mean.group for mean in averages):
        of = [mean for mean in averages if mean.group == group]
        at = [mean[x] for mean in of], [mean[y] for mean in of]
        spread = [mean.spread.get(y, 0.0) for mean in of]
        plot.errorbar(*at, yerr=spread, fmt="o", markersize=5, elinewidth=0.6, label=group or None)
    best = front(comparable(averages), x, y) if best is None else best
    line = [mean[x] for mean in best], [mean[y] for mean in best]
    plot.plot(*line, color="0.4", linewidth=1.0, zorder=0, label="Pareto front")
    named = [mean for mean in averages if mean in best or mean.configuration in labels]
    key = []
    for number, mean in enumerate(sorted(named, key=lambda mean: mean[x]), start=1):
        name = labels.get(mean.configuration) or mean.configuration
        key.append(f"{number}  {name}: {mean[x]:.3g}, {mean[y]:.3g}")
        plot.annotate(
            str(number), (mean[x], mean[y]), xytext=(5, 4), textcoords="offset points", fontsize=9
        )
    plot.text(1.02, 1.0, "\n".join(key), transform=plot.transAxes, va="top", fontsize=8)
    if averages and min(mean[x] for mean in averages) > 0:
        plot.set_xscale("log")
        # 1, 2 and 5 of every decade: all nine run into each other where points are hours apart.
        plot.xaxis.get_major_locator().set_params(subs=(1.0, 2.0, 5.0))
        plot.xaxis.set_major_formatter("{x:g}")
        plot.xaxis.set_minor_formatter("")
    if least is not None:
        plot.set_yscale("symlog", linthresh=least)
        plot.set_ylim(bottom=0.0)
    plot.set_xlabel(x)
    plot.set_ylabel(f"{y} (less is better)")
    plot.set_title(title, fontsize=10)
    plot.grid(alpha=0.25, which="both")
    plot.legend(fontsize=7)
    figure.tight_layout()
    save_figure(figure, path)


def new_figure(size: tuple[float, float]) -> Any:  # noqa: ANN401
    """A figure of (width, height) inches without a window or pyplot's global state.

    Raises:
        MatcapError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MatcapError(
            "drawing the picture needs the package matplotlib",
            remedy="install it with: pip install './lab[bench]'",
        ) from error
    figure = Figure(figsize=size)
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Any, path: Path) -> None:  # noqa: ANN401
    """Write a figure as a PNG; the same figure gives the same bytes.

    Raises:
        MatcapError: the file cannot be written.
    """
    with Output.file(path) as file:
        figure.savefig(file, format="png", dpi=110, metadata={"Software": None})
