"""Marks where the flash was: what of a piece's maps goes with the distance from its highlight.

A material knows nothing of the light. What its maps have in rings around the highlight's foot, a
disc, a hole in roughness, grain that fades, is left of the photograph's light; in a field it lies
about as stains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import Exemplar
from matcap.flash.geometry import FlashSetup, highlight_foot

BlockMeans = NDArray[np.float64]


@dataclass(frozen=True)
class MarkSettings:
    """How marks are looked for; docs/notes/verdict.md."""

    blocks: int = 24
    """Along the long side: what is smaller is drawing."""
    rings: int = 6
    """Of equally many blocks: more follow a mark closer, and chance too."""
    toe: float = 0.004
    """Of albedo and F0: bounds logarithms in the dark."""


MARKS = MarkSettings()


def marks(piece: Exemplar, setup: FlashSetup) -> dict[str, float]:
    """Root-mean-square of what goes in rings around the highlight's foot, chance taken off.

    Returns:
        `albedo` and `specular` (logarithm), `roughness`, and `grain`: the logarithm of slopes'
        strength.
    """
    away = _from_foot(piece.size, highlight_foot(setup))
    step = piece.texel_size
    slopes = np.gradient(piece.height[0].astype(np.float64) / step)
    steep = _blocks(np.square(slopes[0]) + np.square(slopes[1]))
    planes = {
        "albedo": _blocks(np.log(piece.diffuse.mean(0, dtype=np.float64) + MARKS.toe)),
        "specular": _blocks(np.log(piece.specular.mean(0, dtype=np.float64) + MARKS.toe)),
        "roughness": _blocks(piece.roughness[0].astype(np.float64)),
        # A flat piece has slopes of a thousandth, from rounding.
        "grain": 0.5 * np.log(steep + 1e-4),
    }
    distances = _blocks(away)
    return {name: in_rings(plane, distances) for name, plane in planes.items()}


def in_rings(values: BlockMeans, distances: BlockMeans) -> float:
    """Deviation of `values` between rings of equal counts, less what chance makes of their scatter.

    The estimate of the variance between groups of an analysis of variance, at least 0.

    Args:
        values: of blocks, any shape.
        distances: theirs from the foot.
    """
    order = np.argsort(distances, axis=None, kind="stable")
    rings = np.array_split(values.ravel()[order], MARKS.rings)
    count = values.size / MARKS.rings
    between = count * np.var([ring.mean() for ring in rings], ddof=1)
    within = sum(np.square(ring - ring.mean()).sum() for ring in rings)
    within /= max(values.size - MARKS.rings, 1)
    return float(np.sqrt(max(between - within, 0.0) / count))


def worst_mark(found: Mapping[str, float], limits: Mapping[str, float]) -> tuple[str, float]:
    """The map whose mark is largest by its limit, and how often it has it."""
    name = max(limits, key=lambda one: found[one] / limits[one])
    return name, found[name] / limits[name]


def _from_foot(size: tuple[int, int], foot: tuple[float, float]) -> BlockMeans:
    width, height = size
    v, u = np.mgrid[:height, :width] + 0.5
    return np.hypot(2.0 * u / width - 1.0 - foot[0], (height - 2.0 * v) / width - foot[1])


def _blocks(plane: BlockMeans) -> BlockMeans:
    """Means of square blocks; what is left over at the end belongs to the last ones."""
    side = max(1, max(plane.shape) // MARKS.blocks)
    rows, columns = (np.arange(0, max(n - side, 0) + 1, side) for n in plane.shape)
    counts = [np.diff([*starts, n]) for starts, n in zip((rows, columns), plane.shape, strict=True)]
    sums = np.add.reduceat(np.add.reduceat(plane, rows, 0), columns, 1)
    return np.asarray(sums / np.multiply.outer(*counts), np.float64)
