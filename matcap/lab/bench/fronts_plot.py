"""The one picture of what accuracy costs: floors against seconds, with what one sees along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.files.staging import staged_file
from matcap.lab.bench.plot import new_figure
from matcap.lab.bench.table import Point, front

# Groups, as they are drawn and called; others are left to the table.
_DRAWN: Mapping[str, tuple[str, str]] = {
    "one photograph": ("tab:blue", "one photograph"),
    "several": ("tab:green", "several photographs"),
    "decoder": ("tab:gray", "decoder"),
    "paper": ("tab:red", "the paper's form"),
}
_SHEETS = 6  # at most, truth among them
_WIDTH = 1.0 / _SHEETS


def draw_fronts(
    found: Sequence[Point],
    presets: Mapping[str, str],
    path: Path,
    *,
    title: str,
    sheets: Mapping[str, Path],
) -> None:
    """Draw the points, and sheets of some above them, as a PNG.

    Args:
        found: points; `error` against `seconds`.
        presets: points that are one, by their name.
        path: of the picture.
        title: what it tells, in one sentence.
        sheets: pictures by point, "truth" among them; those of points along the front are shown.

    Raises:
        MatcapError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure((10.0, 7.6))
    axes = figure.add_axes((0.07, 0.08, 0.91, 0.52))
    best = front(found)
    for group, (colour, name) in _DRAWN.items():
        of = sorted((p for p in found if p.group == group), key=lambda p: p.seconds)
        if of:
            axes.scatter(
                [p.seconds for p in of], [p.error for p in of], color=colour, label=name, zorder=3
            )
    axes.step(
        [p.seconds for p in best],
        [p.error for p in best],
        where="post",
        color="0.6",
        zorder=1,
        label="nothing is better for less",
    )
    drawn = [point for point in found if point.group in _DRAWN]
    for point in drawn:
        preset = presets.get(point.name)
        if preset or (point in best and point.name not in sheets):  # sheets have names
            axes.annotate(
                preset or point.name,
                (point.seconds, point.error),
                xytext=(4, 6) if preset else (4, -8),
                textcoords="offset points",
                rotation=25 if preset else -25,  # neighbours are closer than names are long
                rotation_mode="anchor",
                fontsize=10 if preset else 8,
                fontweight="bold" if preset else "normal",
            )
    axes.set_xscale("log")
    seconds = [point.seconds for point in drawn or found]
    axes.set_xlim(min(seconds) / 1.2, max(seconds) * 1.7)  # names stand to the right of points
    axes.set_ylim(bottom=1.0)
    axes.xaxis.get_major_locator().set_params(subs=(1.0, 2.0, 5.0))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set_xlabel("processor seconds of the whole command")
    axes.set_ylabel("floors by SqueezeNet: 1 is another true piece")
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8, loc="center right")
    figure.suptitle(title, fontsize=12)
    _sheets(figure, axes, best, presets, sheets)
    with staged_file(path) as file:
        figure.savefig(file, format="png", dpi=110, metadata={"Software": None})


def _sheets(
    figure: Any,  # noqa: ANN401
    axes: Any,  # noqa: ANN401
    best: Sequence[Point],
    presets: Mapping[str, str],
    sheets: Mapping[str, Path],
) -> None:
    """Truth at the left, then points along the front, each tied to its place."""
    shown: list[tuple[str, Point | None]] = [("truth", None)] if "truth" in sheets else []
    of_front = [point for point in best if point.name in sheets]
    # The ends, and what lies evenly between them.
    places = np.linspace(0, len(of_front) - 1, min(len(of_front), _SHEETS - 1)).round().astype(int)
    shown += [(of_front[place].name, of_front[place]) for place in places]
    for place, (name, point) in enumerate(shown):
        box = figure.add_axes((0.01 + place * _WIDTH, 0.64, 0.9 * _WIDTH, 0.27))
        box.imshow(_read(sheets[name]), aspect="equal")
        box.set_axis_off()
        told = presets.get(name, name)
        told = told if point is None else f"{told}\n{point.error:.2f} floors in the mean"
        box.set_title(told, fontsize=8)
        if point is not None:
            box.annotate(
                "",
                (point.seconds, point.error),
                (0.5, 0.0),
                xycoords=axes.transData,
                textcoords="axes fraction",
                arrowprops={"arrowstyle": "-", "color": "0.75", "linewidth": 0.8},
            )


def _read(sheet: Path) -> NDArray[np.uint8]:
    """The sheet's middle, red first: small prints show no more."""
    picture = cv2.imread(str(sheet), cv2.IMREAD_COLOR)
    assert picture is not None
    height, width = picture.shape[:2]
    first = picture[: height // 2]  # of the lights one above the other
    side = min(first.shape[:2]) * 3 // 4
    return np.ascontiguousarray(first[:side, :side, ::-1])
