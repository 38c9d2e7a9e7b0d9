"""Measurements on the maps of a capture themselves: highlight residue, steepness, confidence.

Highlight residue is the radial variation of the maps about the flash's mirror point. A material's
maps do not depend on the light's position: a disc in albedo, a minimum of roughness or relief that
fades towards the mirror point is shading baked into the maps, which synthesis repeats as stains.

Steepness is the relief of a decoder's field over that of the exemplar which it was fine-tuned by.
Under a flash near the lens a dent and a stain look alike, so that statistics of the photograph let
a decoder draw stains as relief. Slopes of waves of 8 to 64 texels are compared: finer ones would
hide slow relief, and decoders blur the finest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import ExemplarEstimate, map_set_of
from matcap.capture.exemplar.relief_spectrum import slope_spectrum
from matcap.capture.rectified import Rectified
from matcap.capture.verdict.highlight import from_mirror_point
from matcap.example.exemplar import Exemplar
from matcap.flash.geometry import FlashSetup

BlockMeans = NDArray[np.float64]

# Settings of the measurements; docs/notes/verdict.md.
_BLOCKS = 24  # blocks along the long side; smaller structure is texture
_RINGS = 6  # rings of equally many blocks; more resolve finer, with more sampling variance
_TOE = 0.004  # added to albedo and F0 before logarithms
_COARSE = slice(0, 3)  # of filters.BANDS: 8 to 64 texels
_FLAT = 0.01  # root-mean-square slope of these waves below which a surface is flat to the eye


@dataclass(frozen=True)
class ExemplarMeasurements:
    """Measurements on an exemplar; the defaults are of a capture without one."""

    error: float = math.nan
    """Median |log radiance of photograph - re-rendering| (ExemplarEstimate.error)."""
    confidence: Mapping[str, float] | None = None
    """Mean confidence by map."""
    residue: Mapping[str, float] | None = None
    """Radial variation of the maps about the mirror point (highlight_residue)."""
    tilt: float = 0.0
    """Mean angle of the normals to the plane's, degrees."""
    steepness: float = math.nan
    """Slopes of a decoder's field over the exemplar's; NaN without a decoder."""
    variety: float = 1.0
    """Patch size of the field: 1 for small patches, 0 for the whole exemplar, whose features are as
    large as the photograph."""

    @staticmethod
    def of(
        estimate: ExemplarEstimate,
        rectified: Rectified,
        setup: FlashSetup,
        drawn: MapSet | None,
    ) -> ExemplarMeasurements:
        """Measure an exemplar.

        Args:
            estimate: the exemplar.
            rectified: its photograph.
            setup: camera and flash, in the orientation of the exemplar.
            drawn: maps of a decoder's field, or None.
        """
        first = estimate.first_rectangle
        cosine = map_set_of(estimate.exemplar).normal[2].clamp(-1.0, 1.0)
        return ExemplarMeasurements(
            error=estimate.error,
            confidence=estimate.mean_confidence(rectified.photo.kept_share),
            residue=highlight_residue(first, setup),
            tilt=float(cosine.acos().rad2deg().mean()),
            steepness=math.nan if drawn is None else steepness(drawn, map_set_of(first)),
            # Of a lattice, whole periods are rearranged, however small they are.
            variety=1.0 if rectified.waves else estimate.example.variety,
        )


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


def steepness(drawn: MapSet, exemplar: MapSet) -> float:
    """Root-mean-square slope of maps over that of an exemplar.

    NaN if both are flat or too small.
    """
    energies = [
        float(np.square(slope_spectrum((maps.height[0] / maps.texel_size).numpy())[_COARSE]).sum())
        for maps in (drawn, exemplar)
    ]
    ours, theirs = (energy + _FLAT**2 for energy in energies)
    return math.sqrt(ours / theirs) if any(energies) else math.nan
