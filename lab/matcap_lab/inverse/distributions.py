"""Marginal distributions of training data against those of real maps and photographs.

Maps: mean tilt, roughness, F0, albedo and its contrast, of real and simulated training samples and
of the map sets themselves. Pictures: contrast without low frequencies, and the share of clipped
pixels, of training samples and of real photographs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap_lab.experiment.plot import new_figure, save_figure
from matcap_lab.experiment.results import markdown
from matcap_lab.inverse.packed import PackedSet
from matcap_lab.inverse.samples import draw_sample

# Statistics of maps, then of pictures, and whether their axis is logarithmic.
QUANTITIES: Mapping[str, bool] = {
    "mean tilt, degrees": False,
    "roughness": False,
    "F0": True,
    "albedo": True,
    "contrast of albedo (log)": False,
    "contrast of picture (log)": False,
    "clipped share": True,
}
_SLOW = 12.0  # texels: deviation of the mean that a picture's contrast is taken from
_LONG_SIDE = 640  # texels that photographs are read at
_CLIPPED, _LEAST = 0.98, 1e-4
_FIRST = 70_000_000  # numbers of samples, beyond training's and evaluation's

Measured = dict[str, list[float]]
Picture = NDArray[np.float32]


def of_maps(maps: MapSet) -> dict[str, float]:
    """Statistics of maps, by name."""
    tilt = maps.normal[..., 2, :, :].clamp(-1.0, 1.0).acos().mean()
    return {
        "mean tilt, degrees": math.degrees(float(tilt)),
        "roughness": float(maps.roughness.mean()),
        "F0": float(maps.specular.mean()),
        "albedo": float(maps.diffuse.mean()),
        "contrast of albedo (log)": float((maps.diffuse.mean(-3) + 1e-3).log().std()),
    }


def of_picture(linear: Picture) -> dict[str, float]:
    """Statistics of a linear picture (H, W, 3), clipped at 1, by name."""
    log = np.log(linear.mean(-1) + 1e-3)
    rest = log - cv2.GaussianBlur(log, (0, 0), _SLOW)
    clipped = float((linear.max(-1) >= _CLIPPED).mean())
    return {"contrast of picture (log)": float(rest.std()), "clipped share": max(clipped, _LEAST)}


def drawn(count: int, sets: Sequence[PackedSet], real: float, size: tuple[int, int]) -> Measured:
    """Statistics of training samples, of real materials (`real` 1) or simulated ones (0)."""

    def measured(index: int) -> dict[str, float]:
        # Neighbouring numbers share a simulated piece.
        sample = draw_sample(_FIRST + 1000 * index, *size, sets=sets, real=real)
        linear = np.ascontiguousarray(sample.linear.permute(1, 2, 0).numpy())
        return {**of_maps(sample.truth), **of_picture(linear)}

    return _columns(map(measured, range(count)))


def of_sets(sets: Sequence[PackedSet]) -> Measured:
    """Statistics of the map sets without augmentation."""
    stacked = (torch.cat([packed.surface[0][:7].float(), packed.height[0]]) for packed in sets)
    return _columns(of_maps(MapSet.from_stacked(maps, 1.0, periodic=True)) for maps in stacked)


def of_photographs(folder: Path, size: tuple[int, int]) -> Measured:
    """Statistics of the middles of real photographs, in windows of the training samples' size.

    Raises:
        MatcapError: there is none.
    """
    measured = []
    for path in sorted(folder.glob("*.jpg")):
        read = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if read is None:
            continue
        scale = _LONG_SIDE / max(read.shape[:2])
        small = cv2.resize(read, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        measured.append(_windows((np.asarray(small, np.float32) / 255.0) ** 2.2, size))
    if not measured:
        raise MatcapError.at(
            folder, "there are no photographs in this folder", "give a folder of JPEGs"
        )
    return _columns(measured)


def plot(measured: Mapping[str, Measured], path: Path) -> None:
    """Cumulative shares of each quantity, a curve a kind, as a PNG.

    Raises:
        MatcapError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure((14.0, 6.0))
    for place, (name, decades) in enumerate(QUANTITIES.items()):
        axes = figure.add_subplot(2, 4, place + 1)
        for kind, values in measured.items():
            if values[name]:
                ordered = np.sort(values[name])
                axes.plot(ordered, np.linspace(0.0, 1.0, len(ordered)), label=kind, linewidth=1.2)
        if decades:
            axes.set_xscale("log")
        axes.set_title(name, fontsize=9)
        axes.grid(alpha=0.25)
        axes.legend(fontsize=7)
    figure.tight_layout()
    save_figure(figure, path)


def table(measured: Mapping[str, Measured]) -> str:
    """Markdown: 5, 25, 50, 75 and 95 % of each quantity, a column a kind."""
    rows = []
    for name in QUANTITIES:
        row = [name]
        for values in measured.values():
            shares = (0.05, 0.25, 0.5, 0.75, 0.95) if values[name] else ()
            row.append(" ".join(f"{np.quantile(values[name], s):.3g}" for s in shares))
        rows.append(row)
    return "\n".join(markdown(["5, 25, 50, 75, 95 %", *measured], rows))


def _windows(linear: Picture, size: tuple[int, int]) -> dict[str, float]:
    """Means of the statistics over a picture's windows."""
    width, height = size
    rows, columns = linear.shape[0] // height, linear.shape[1] // width
    each = [
        of_picture(
            np.ascontiguousarray(linear[y * height : (y + 1) * height, x * width : (x + 1) * width])
        )
        for y in range(rows)
        for x in range(columns)
    ]
    return {name: float(np.mean([e[name] for e in each])) for name in each[0]}


def _columns(measured: Iterable[Mapping[str, float]]) -> Measured:
    """Every quantity's values; none where it was not measured."""
    every = list(measured)
    return {name: [one[name] for one in every if name in one] for name in QUANTITIES}
