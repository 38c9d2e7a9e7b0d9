"""Highlight residue: radial variation of the maps about the flash's mirror point.

A material's maps do not depend on the light's position: a disc in albedo, a minimum of roughness or
relief that fades towards the mirror point is shading baked into the maps, which synthesis repeats
as stains.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.capture.verdict.highlight import from_mirror_point
from matcap.example.exemplar import Exemplar
from matcap.flash.geometry import FlashSetup

BlockMeans = NDArray[np.float64]


# Settings of the measurement of what the highlight left in the maps; docs/notes/verdict.md.
_BLOCKS = 24  # blocks along the long side; smaller structure is texture
_RINGS = 6  # rings of equally many blocks; more resolve finer, with more sampling variance
_TOE = 0.004  # added to albedo and F0 before logarithms


def highlight_residue(exemplar: Exemplar, setup: FlashSetup) -> dict[str, float]:
    """Standard deviation of ring means about the mirror point, sampling variance subtracted.

    Returns:
        `albedo` and `specular` (natural log), `roughness`, and `grain` (log of the local
        root-mean-square slope).
    """
    distance = from_mirror_point(setup, exemplar.size[::-1])
    step = exemplar.texel_size
    slopes = np.gradient(exemplar.height[0].astype(np.float64) / step)
    steep = _blocks(np.square(slopes[0]) + np.square(slopes[1]))
    planes = {
        "albedo": _blocks(np.log(exemplar.diffuse.mean(0, dtype=np.float64) + _TOE)),
        "specular": _blocks(np.log(exemplar.specular.mean(0, dtype=np.float64) + _TOE)),
        "roughness": _blocks(exemplar.roughness[0].astype(np.float64)),
        # A flat exemplar has slopes of a thousandth, from rounding.
        "grain": 0.5 * np.log(steep + 1e-4),
    }
    distances = _blocks(distance)
    return {name: in_rings(plane, distances) for name, plane in planes.items()}


def in_rings(values: BlockMeans, distances: BlockMeans) -> float:
    """Standard deviation of `values` between rings of equal counts, without sampling variance.

    Root of the between-group variance component of a one-way analysis of variance, at least 0.

    Args:
        values: block means, any shape.
        distances: of the blocks from the mirror point, same shape.
    """
    order = np.argsort(distances, axis=None, kind="stable")
    rings = np.array_split(values.ravel()[order], _RINGS)
    count = values.size / _RINGS
    between = count * np.var([ring.mean() for ring in rings], ddof=1)
    within = sum(np.square(ring - ring.mean()).sum() for ring in rings)
    within /= max(values.size - _RINGS, 1)
    return float(np.sqrt(max(between - within, 0.0) / count))


def _blocks(plane: BlockMeans) -> BlockMeans:
    """Means of square blocks; the last ones include the remaining rows and columns."""
    side = max(1, max(plane.shape) // _BLOCKS)
    rows, columns = (np.arange(0, max(n - side, 0) + 1, side) for n in plane.shape)
    counts = [np.diff([*starts, n]) for starts, n in zip((rows, columns), plane.shape, strict=True)]
    sums = np.add.reduceat(np.add.reduceat(plane, rows, 0), columns, 1)
    return np.asarray(sums / np.multiply.outer(*counts), np.float64)
