"""The one picture of accuracy against time, for every bench (extra `bench`: matplotlib)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matcap.errors import MatcapError
from matcap.files.staging import staged_file
from matcap.lab.bench.table import Point, comparable, front

_LABELLED = "preset"  # group whose points bear their names even off the front


def draw(
    found: Sequence[Point], path: Path, *, title: str, error: str, least: float | None = None
) -> None:
    """Draw error against seconds, the Pareto front joined and named, as a PNG.

    Args:
        found: the points; whiskers show the spread over their subjects.
        path: of the picture.
        title: above it.
        error: what the error counts in.
        least: errors go over decades, down to this one; None where they do not.

    Raises:
        MatcapError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure((9.0, 5.6))
    axes = figure.add_subplot()
    for group in dict.fromkeys(point.group for point in found):
        of = [point for point in found if point.group == group]
        axes.errorbar(
            [point.seconds for point in of],
            [point.error for point in of],
            yerr=[point.spread for point in of],
            fmt="s" if group == _LABELLED else "o",
            markersize=8 if group == _LABELLED else 5,
            zorder=3 if group == _LABELLED else 2,
            elinewidth=0.6,
            alpha=0.85,
            label=group,
        )
    best = front(comparable(found))
    axes.plot(
        [point.seconds for point in best],
        [point.error for point in best],
        color="0.4",
        linewidth=1.0,
        zorder=0,
        label="Pareto front",
    )
    for point in found:
        if point in best or point.group == _LABELLED:
            axes.annotate(
                point.name,
                (point.seconds, point.error),
                xytext=(5, 4),
                textcoords="offset points",
                fontsize=7,
            )
    if found and min(point.seconds for point in found) > 0:
        axes.set_xscale("log")
        # 1, 2 and 5 of every decade: all nine run into each other where points are hours apart.
        axes.xaxis.get_major_locator().set_params(subs=(1.0, 2.0, 5.0))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
    if least is not None:
        axes.set_yscale("symlog", linthresh=least)
        axes.set_ylim(bottom=0.0)
    axes.set_xlabel("seconds")
    axes.set_ylabel(error)
    axes.set_title(title, fontsize=10)
    axes.grid(alpha=0.25, which="both")
    axes.legend(fontsize=7)
    figure.tight_layout()
    with staged_file(path) as file:
        figure.savefig(file, dpi=110, metadata={"Software": None})


def new_figure(size: tuple[float, float]) -> Any:  # noqa: ANN401
    """A figure of so many inches that belongs to no window: nothing global is touched.

    Raises:
        MatcapError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MatcapError(
            "drawing the picture needs the package matplotlib",
            remedy="install it with: pip install 'matcap[bench]'",
        ) from error
    figure = Figure(figsize=size)
    FigureCanvasAgg(figure)
    return figure
