"""Measured causes of a poor capture: in photograph, re-rendering, maps, highlight and glints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.exemplar.estimate import ExemplarEstimate
from matcap.capture.exemplar.mean_parameters import BOUND
from matcap.capture.exemplar.octaves import filled
from matcap.capture.exemplar.refine import LEAST_SHARE, MIRRORED
from matcap.capture.rectified import Rectified
from matcap.example.example import Example, coarse_places, detail_bits
from matcap.example.exemplar import Exemplar
from matcap.field.plane import Rectangle
from matcap.flash.geometry import FlashSetup, flash_mirror_point, points_of
from matcap.flash.highlight import FAINTEST_HIGHLIGHT, Highlight, elongation, light_of
from matcap.flash.light import FlashLight, cached_rows, strips
from matcap.photo.checks import CAUSES, UNIFORM, Cause
from matcap.photo.inspect import channel_mean

# Highlight contrast and glint contrast, re-rendered over photographed.
#
# Both pictures are clipped at the photograph's clip level, then averaged in rings around the mirror
# point and divided by M, a uniform matte surface under the same flash. With <> a mean over texels,
#
# profile(r) = <L>_r / <M>_r,    contrast = profile(r < NEAR) / profile(r > FAR),
#
# and 1 is a matte surface. Glint contrast is the standard deviation of log L in octaves of spatial
# frequency, where the specular fraction of the photograph is at least MIRRORED.

Picture = NDArray[np.float32]
TexelMask = NDArray[np.bool_]

NEAR, FAR = 0.06, 0.3  # plane units from the mirror point
_EDGES = (0.0, NEAR, 0.085, 0.12, 0.17, 0.24, FAR, 9.0)  # radii, plane units; two rings per octave
UNSEEN = 0.01  # standard deviation of log radiance that is invisible
_OCTAVES = 3  # number, from 1 texel on
_DARKEST = 1e-4  # radiance below which logarithms are clamped


@dataclass(frozen=True)
class HighlightProfile:
    """A highlight in photograph and re-rendering, clipped alike; pairs are in this order."""

    rings: tuple[tuple[float, float], ...]
    """By ring from the innermost: profile(r) over the outermost's; the first is the contrast."""
    clipped: tuple[float, ...]
    """By ring: share that is clipped in the photograph."""
    glints: tuple[tuple[float, float], ...] = ()
    """By octave, finest first: standard deviation of log radiance; empty without a highlight."""

    @property
    def contrast(self) -> tuple[float, float]:
        """Highlight contrast (module equation) of photograph and re-rendering; 1 is matte."""
        return self.rings[0]

    @property
    def glossy(self) -> bool:
        """Whether either picture has a highlight."""
        return max(self.contrast) >= FAINTEST_HIGHLIGHT

    @property
    def bound(self) -> bool:
        """Whether the photographed contrast is only a lower bound, as its core is clipped."""
        return self.clipped[0] > BOUND

    @property
    def ratio(self) -> float:
        """Highlight contrast, re-rendered over photographed; NaN if neither is glossy.

        If the core is clipped, the innermost unclipped ring of the highlight is compared as well;
        the ratio farther from 1 is returned.
        """
        if not self.glossy:
            return math.nan
        measured = (
            after / before
            for (before, after), clipped in zip(self.rings, self.clipped, strict=True)
            if clipped <= BOUND and max(before, after) >= FAINTEST_HIGHLIGHT
        )
        core = self.contrast[1] / self.contrast[0]
        return max((core, next(measured, core)), key=lambda ratio: abs(math.log(ratio)))

    @property
    def glint_ratio(self) -> float:
        """Glint contrast of all octaves, re-rendered over photographed; NaN without a highlight.

        UNSEEN, the visibility threshold, is added to both in quadrature.
        """
        if not self.glints:
            return math.nan
        before, after = (math.hypot(UNSEEN, *each) for each in zip(*self.glints, strict=True))
        return after / before

    def document(self) -> Mapping[str, Any]:
        """JSON; radii in plane units."""
        return {
            "radii": list(_EDGES[1:-1]),
            "rings": [list(pair) for pair in self.rings],
            "clipped": list(self.clipped),
            "contrast_ratio": self.ratio,
            "glints": [list(pair) for pair in self.glints],
            "glint_ratio": self.glint_ratio,
        }


def highlight_profile(
    pictures: tuple[Picture, Picture],
    seen: TexelMask,
    measured: TexelMask,
    setup: FlashSetup,
    limit: float = 1.0,
) -> HighlightProfile | None:
    """Radial profiles and glints of both pictures; None if the mirror point is outside of them.

    Args:
        pictures: (H, W, 3) radiance of photograph and re-rendering on the plane's grid, clipped
            alike; one picture may be both.
        seen: (H, W) bool, inside of the photograph.
        measured: (H, W) bool, `seen` and not clipped.
        limit: radiance at which the pictures are clipped.
    """
    different = pictures[0] is not pictures[1]
    lights = [channel_mean(picture) for picture in pictures[: 1 + different]]
    distance, matte = from_mirror_point(setup, seen.shape), _matte(setup, seen.shape)
    rings = [
        seen & (distance >= inner) & (distance < outer)
        for inner, outer in zip(_EDGES, _EDGES[1:], strict=False)
    ]
    if not all(ring.any() for ring in rings):
        return None
    profiles = np.array([[one[ring].sum() / matte[ring].sum() for one in lights] for ring in rings])
    profiles = np.maximum(profiles, _DARKEST)  # a ring may be black
    profiles /= profiles[-1]
    reach = _reach(profiles[:, 0])
    region = seen & measured & (lights[-1] < limit) & (distance < reach)
    glints = [_octaves(one, region) for one in lights] if region.mean() >= LEAST_SHARE else [[]]
    return HighlightProfile(
        tuple((float(ring[0]), float(ring[-1])) for ring in profiles),
        tuple(float((~measured[ring]).mean()) for ring in rings),
        tuple(zip(glints[0], glints[-1], strict=True)),
    )


def _reach(profile: NDArray[np.float64]) -> float:
    """Radius within which the specular fraction is at least MIRRORED; 0 for none."""
    mirrored = 1.0 - 1.0 / np.maximum(profile[:-1], 1e-9) >= MIRRORED
    return _EDGES[len(mirrored) if mirrored.all() else int(mirrored.argmin())]


def _octaves(picture: Picture, region: TexelMask) -> list[float]:
    """Standard deviation of log radiance over a region, by octave, finest first."""
    log = filled(np.log(np.maximum(picture, _DARKEST)).astype(np.float32), region)
    blurs = (cv2.GaussianBlur(log, (0, 0), 2.0**octave) for octave in range(_OCTAVES + 1))
    return [float((a - b)[region].std()) for a, b in pairwise(blurs)]


def from_mirror_point(setup: FlashSetup, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """(H, W) distance from the mirror point, plane units; upright if the setup is turned."""
    if setup.turned:
        landscape = from_mirror_point(replace(setup, turned=False), shape[::-1])
        return np.rot90(landscape, -1)
    (x, y), (height, width) = flash_mirror_point(setup), shape
    u, v = np.arange(width) + 0.5, np.arange(height)[:, None] + 0.5
    return np.hypot(2.0 * u / width - 1.0 - x, (height - 2.0 * v) / width - y)


def _matte(setup: FlashSetup, shape: tuple[int, ...]) -> Picture:
    """(H, W) radiance of a white matte plane: power (n.l) / pi."""

    def some(rows: slice) -> Tensor:
        light = FlashLight.of(setup, points_of(shape, rows))
        return light.power.mean(0) * light.to_light[2] / math.pi

    return torch.cat([some(rows) for rows in strips(shape[0], cached_rows(shape[1]))]).numpy()


# Measurements on the maps of a capture themselves: highlight residue, steepness, confidence.
#
# Highlight residue is the radial variation of the maps about the flash's mirror point. A material's
# maps do not depend on the light's position: a disc in albedo, a minimum of roughness or relief
# that fades towards the mirror point is shading baked into the maps, which synthesis repeats as
# stains.

BlockMeans = NDArray[np.float64]

# Settings of the measurements; docs/notes/verdict.md.
_BLOCKS = 24  # blocks along the long side; smaller structure is texture
_RINGS = 6  # rings of equally many blocks; more resolve finer, with more sampling variance
_TOE = 0.004  # added to albedo and F0 before logarithms
_PART = 16  # texels of a side of a part of the exemplar, of which recurrences are counted


@dataclass(frozen=True)
class ExemplarMeasurements:
    """Measurements on an exemplar; the defaults are of a capture without one."""

    error: float = math.nan
    """Median |log radiance of photograph - re-rendering| (ExemplarEstimate.error)."""
    confidence: Mapping[str, float] | None = None
    """Mean confidence by map."""
    residue: Mapping[str, float] | None = None
    """Radial variation of the maps about the mirror point (highlight_residue)."""
    variety: float = 1.0
    """Patch size of the field: 1 for small patches, 0 for the whole exemplar, whose features are as
    large as the photograph."""
    repeats: float = 0.0
    """Times that each part that is shown is shown in a field as large as the photograph; 0 without
    patches."""

    @staticmethod
    def of(
        estimate: ExemplarEstimate, rectified: Rectified, setup: FlashSetup, seed: int | None
    ) -> ExemplarMeasurements:
        """Measure an exemplar.

        Args:
            setup: camera and flash, in the orientation of the exemplar.
            seed: of its field; None if a decoder makes the field.
        """
        first, example = estimate.first_rectangle, estimate.example
        return ExemplarMeasurements(
            error=estimate.error,
            confidence=estimate.mean_confidence(rectified.photo.kept_share),
            residue=highlight_residue(first, setup),
            # Of a lattice, whole periods are rearranged, however small they are; of variety 0
            # nothing is.
            variety=1.0 if rectified.waves and example.variety else example.variety,
            repeats=0.0 if seed is None else _repeats(example, first.size, seed),
        )


def _repeats(example: Example, size: tuple[int, int], seed: int) -> float:
    """Mean over a field of (width, height) texels of how often its parts of the exemplar recur."""
    level = max(detail_bits(example.exemplar), 2)
    squares = Rectangle(0, 0, size[0] >> level, size[1] >> level)
    part = coarse_places(example, seed, level, squares).astype(np.int64) // _PART
    counts = np.unique(part[..., 1] << 16 | part[..., 0], return_counts=True)[1]
    return float(np.square(counts).sum() / counts.sum()) / (_PART >> level) ** 2


def highlight_residue(exemplar: Exemplar, setup: FlashSetup) -> dict[str, float]:
    """Standard deviation of ring means about the mirror point, sampling variance subtracted.

    Returns:
        `albedo` and `specular` (natural log), `roughness`, and `grain` (log of the local
        root-mean-square slope).
    """
    distances = _blocks(from_mirror_point(setup, exemplar.size[::-1]))
    down, across = np.gradient(exemplar.height[0].astype(np.float64) / exemplar.texel_size)
    down *= down
    across *= across
    down += across
    steep = _blocks(down)
    del down, across
    planes = {
        "albedo": _blocks(np.log(exemplar.diffuse.mean(0, dtype=np.float64) + _TOE)),
        "specular": _blocks(np.log(exemplar.specular.mean(0, dtype=np.float64) + _TOE)),
        "roughness": _blocks(exemplar.roughness[0].astype(np.float64)),
        # A flat exemplar has slopes of a thousandth, from rounding.
        "grain": 0.5 * np.log(steep + 1e-4),
    }
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


# Measurements of causes of a poor capture, in photograph and re-rendering.
#
# A cause is reported if its measurement exceeds its limit in the table (photo/checks.py).

SmoothLight = NDArray[np.float64]

_RING_TERMS = 6  # piecewise linear terms in the distance from the centre
# Quantile of the light above which texels are not fitted, as the highlight errs there.
_BRIGHTEST = 0.7
_STRIP = 0.06  # width of the border that represents a side, as a share of the picture's
# Inner and outer radius, plane units, of the ring that represents the centre.
_CENTRE_RING = (0.25, 0.5)


def measure_causes(
    smooth: tuple[SmoothLight, SmoothLight],
    pictures: tuple[Picture, Picture],
    highlights: tuple[Highlight | None, Highlight | None],
    exemplar: ExemplarMeasurements,
) -> dict[str, float]:
    """Measurement of each cause by its name.

    Args:
        smooth: (h, w, 3) low-pass filtered photograph and re-rendering on the plane.
        pictures: (H, W, 3) both, unfiltered.
    """
    light, model = (each.mean(axis=2) for each in smooth)
    side = _brightest_side(light)
    uniform = 0.0 <= side <= UNIFORM
    return {
        "anisotropic highlight": _streak(pictures, highlights),
        "light from a side": -math.inf if uniform else side,
        "room light": _ambient_share(light, model),
        "large features": exemplar.variety,
    }


def causes(measured: Mapping[str, float]) -> tuple[Cause, ...]:
    """Causes beyond their limits, the strongest first."""
    strengths = {name: CAUSES[name].strength(value) for name, value in measured.items()}
    visible = [name for name in strengths if strengths[name] >= 1.0]
    return tuple(
        CAUSES[name].described(measured[name])
        for name in sorted(visible, key=lambda name: -strengths[name])
    )


def by_place(difference: SmoothLight) -> SmoothLight:
    """(h, w) projection of a difference on functions that are linear in position or depend on the
    distance from the centre: light varies so, texture hardly does.
    """
    terms = np.concatenate([_plane(difference.shape), _rings(difference.shape)])
    flat = terms.reshape(len(terms), -1)
    coefficients = np.linalg.lstsq(flat.T, difference.ravel(), rcond=1e-9)[0]
    return np.einsum("n,nhw->hw", np.asarray(coefficients, np.float64), terms)


def _brightest_side(light: SmoothLight) -> float:
    """Log ratio of the brightest side to the surroundings of the centre, of smooth light (h, w)."""
    height, width = light.shape
    rows, columns = (max(1, round(_STRIP * side)) for side in (height, width))
    sides = (light[:rows], light[-rows:], light[:, :columns], light[:, -columns:])
    distance = np.hypot(*_from_middle(light.shape)) * 2.0
    around = light[(distance > _CENTRE_RING[0]) & (distance < _CENTRE_RING[1])]
    brightest = max(float(np.median(side)) for side in sides)
    return float(np.log((brightest + 1e-6) / (np.median(around) + 1e-6)))


def _ambient_share(light: SmoothLight, model: SmoothLight) -> float:
    """Offset b of the fit light = a model + b, over the 10 % quantile of light."""
    fit = model < np.quantile(model, _BRIGHTEST)
    weight = 1.0 / (model[fit] + 1e-6)  # relative residuals
    columns = np.stack([model[fit] * weight, weight], axis=1)
    added = float(np.linalg.lstsq(columns, light[fit] * weight, rcond=None)[0][1])
    return max(added, 0.0) / (float(np.quantile(light, 0.1)) + 1e-6)


def _streak(
    pictures: tuple[Picture, Picture], highlights: tuple[Highlight | None, Highlight | None]
) -> float:
    """Length over width of the highlight over that re-rendered; 1 without one in the photograph."""
    photographed, rendered = (
        1.0 if highlight is None else elongation(light_of(picture), highlight)
        for picture, highlight in zip(pictures, highlights, strict=True)
    )
    return max(photographed / rendered, 1.0)


def _plane(shape: Sequence[int]) -> SmoothLight:
    """(2, h, w) from -1/2 at one side to 1/2 at the other."""
    down, across = (np.linspace(-0.5, 0.5, side) for side in shape)
    return np.stack(np.broadcast_arrays(across[None, :], down[:, None]))


def _rings(shape: Sequence[int]) -> SmoothLight:
    """(rings, h, w) linear interpolation weights in the distance from the centre; they sum to 1."""
    distance = np.hypot(*_from_middle(shape))
    at = distance / distance.max() * (_RING_TERMS - 1)
    return np.stack([np.clip(1.0 - np.abs(at - ring), 0.0, 1.0) for ring in range(_RING_TERMS)])


def _from_middle(shape: Sequence[int]) -> tuple[SmoothLight, SmoothLight]:
    """Offsets of columns (1, w) and rows (h, 1) from the centre; the long side is 1."""
    down, across = ((np.arange(side) + 0.5 - side / 2.0) / max(shape) for side in shape)
    return across[None, :], down[:, None]
