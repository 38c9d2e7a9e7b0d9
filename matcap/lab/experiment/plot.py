"""Plot of error against cost, for every experiment (extra `bench`: matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from matcap.errors import MatcapError
from matcap.files.output import Output
from matcap.lab.experiment.results import Mean, comparable, front


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
            remedy="install it with: pip install 'matcap[bench]'",
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
