"""An exemplar between two exemplars: their maps laid over each other, and interpolated by octave.

Places of both (correspondence.py) give two sets of maps on one grid, blended at seams (blend.py).
Diffuse albedo and F0 are interpolated as square roots, which is about even to the eye; roughness
and height, in texels, as they are. With B_1k, B_2k the octaves of a map's plane at the share t,

    B_k = g_k ((1 - t) B_1k + t B_2k),    log s(B_k) = (1 - t) log s_1k + t log s_2k,

g_k restoring the deviations s that the exemplars' own octaves have: the mean of two different
textures alone would lose contrast. Means and drifts are interpolated. Values of all maps but height
are then mapped by rank to the distribution of interpolated quantiles. Slopes follow from height.

F0 of a dielectric and of a metal are interpolated like any others, and diffuse albedo too, so that
it fades as F0 rises and their sum stays within 1: a dull sheen half-way.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from matcap.example.blend import ExemplarBands, Votes, bands_of, blended, seam_correlations
from matcap.example.correspondence import Coordinates, by_rank, lerp, octaves, overlay
from matcap.example.exemplar import CHANNELS, COLOURED, DIFFUSE, HEIGHT, SPECULAR, Exemplar, Floats
from matcap.field.plane import Rectangle

_UNSEEN = 0.003  # deviation of an octave that is not visible; roots of albedo, roughness, texels
_QUANTILES = np.linspace(0.0, 1.0, 513)
_BEYOND = 96  # texels beyond the grid that nodes of the coarsest band read; a multiple of 8
_LEVELS = 5  # of places: as many as blend.py reads
_MEASURED = 128  # texels a side of the part whose seams are measured


def interpolated(first: Exemplar, second: Exemplar, share: float) -> Exemplar:
    """An exemplar between two; shares 0 and 1 return the given ones.

    It has the size in plane units of the nearer one, and a texel size interpolated as a logarithm.
    Its confidence is the geometric mean of both, weighted by the shares.

    Args:
        first, second: of at least 14 texels a side.
        share: of the second, in [0, 1].
    """
    if share in (0.0, 1.0):
        return second if share else first
    texel = first.texel_size ** (1.0 - share) * second.texel_size**share
    ends = [_resampled(end, texel) for end in (first, second)]
    if ends[0].coloured != ends[1].coloured:
        ends = [_coloured(end) for end in ends]
    laid = overlay(ends[0], ends[1], share, ends[round(share)].size)
    shown = [
        _roots(_shown(end, places), texel)
        for end, places in zip(ends, (laid.first, laid.second), strict=True)
    ]
    own = [_roots(end.stacked(), texel) for end in ends]
    maps = np.stack([
        _plane_between((shown[0][plane], shown[1][plane]), (own[0][plane], own[1][plane]), share,
                 ranked=plane < len(own[0]) - 1)
        for plane in range(len(own[0]))
    ])  # fmt: skip
    confidence = [
        end.confidence[:, places[..., 1], places[..., 0]]
        for end, places in zip(ends, (laid.first, laid.second), strict=True)
    ]
    return Exemplar(
        diffuse=np.square(maps[DIFFUSE].clip(0.0, 1.0)),
        specular=np.square(maps[SPECULAR].clip(0.0, 1.0)),
        roughness=maps[-2:-1].clip(0.0, 1.0),
        height=maps[HEIGHT] * np.float32(texel),
        confidence=np.power(confidence[0], 1.0 - share) * np.power(confidence[1], share),
        texel_size=texel,
    )


def _resampled(exemplar: Exemplar, texel_size: float) -> Exemplar:
    """An exemplar resampled to another texel size."""
    scale = exemplar.texel_size / texel_size
    size = tuple(max(1, round(side * scale)) for side in exemplar.size)
    if size == exemplar.size:
        return replace(exemplar, texel_size=texel_size)
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    resized = {
        name: np.stack([cv2.resize(p, size, interpolation=how) for p in getattr(exemplar, name)])
        for name in (*CHANNELS, "confidence")
    }
    for name in resized.keys() - {"height"}:
        resized[name].clip(0.0, 1.0, out=resized[name])  # weights are rounded
    return replace(exemplar, **resized, texel_size=texel_size)


def _coloured(exemplar: Exemplar) -> Exemplar:
    channels = COLOURED // len(exemplar.specular)
    return replace(exemplar, specular=exemplar.specular.repeat(channels, axis=0))


def _roots(stacked: Floats, texel_size: float) -> Floats:
    """Stacked maps as they are interpolated: square roots of albedo and F0, height in texels."""
    roots = stacked.copy()
    roots[DIFFUSE], roots[SPECULAR] = np.sqrt(roots[DIFFUSE]), np.sqrt(roots[SPECULAR])
    roots[HEIGHT] /= np.float32(texel_size)
    return roots


def _shown(exemplar: Exemplar, places: Coordinates) -> Floats:
    """(6 or 8, H, W) stacked maps of an exemplar at places, blended at seams."""
    rows, columns = places.shape[:2]
    area, bands = Rectangle(0, 0, columns, rows), bands_of(exemplar)
    down, across = (np.arange(-_BEYOND, side + _BEYOND) for side in (rows, columns))
    inside = down.clip(0, rows - 1), across.clip(0, columns - 1)
    # Beyond the grid, places go on as at its border.
    around = places[np.ix_(*inside)]
    around[..., 0] += across - inside[1]
    around[..., 1] += (down - inside[0])[:, None]
    around = around.clip(0, np.array(exemplar.size) - 1).astype(np.int16)
    votes = []
    for band in range(len(bands)):
        vote = Votes.of(band, area, None, 0, _LEVELS)
        step, wanted = 1 << vote.level, vote.wanted
        y, x = (
            (np.arange(start, start + count) * step + _BEYOND).clip(0, len(axis) - 1)
            for start, count, axis in (
                (wanted.y, wanted.height, down), (wanted.x, wanted.width, across),
            )
        )  # fmt: skip
        votes.append((vote, vote.predicted(around[np.ix_(y, x)], area)))
    own = around[_BEYOND : _BEYOND + rows, _BEYOND : _BEYOND + columns]
    correlations = seam_correlations(bands, own[:_MEASURED, :_MEASURED], 1)
    planes = tuple(plane for name in CHANNELS for plane in getattr(exemplar, name))
    return blended(ExemplarBands(planes, bands, correlations, 0), area, own, votes)


def _plane_between(
    shown: tuple[Floats, Floats], own: tuple[Floats, Floats], share: float, *, ranked: bool
) -> Floats:
    """Interpolate a plane; see the module's equations.

    Args:
        shown: (H, W) of both on the common grid.
        own: (H, W) of the exemplars themselves.
        share: of the second.
        ranked: interpolate quantiles too.
    """
    first, second = (octaves(plane) for plane in shown)
    deviations = [[float(octave.std()) for octave in octaves(plane)] for plane in own]
    drift = lerp(shown[0] - np.sum(first, axis=0), shown[1] - np.sum(second, axis=0), share)
    means = [float(plane.mean()) for plane in own]
    mixed = drift - drift.mean() + np.float32((1.0 - share) * means[0] + share * means[1])
    for one, other, *wanted in zip(first, second, *deviations, strict=True):
        octave = lerp(one, other, share)
        logs = [math.log(deviation + _UNSEEN) for deviation in wanted]
        deviation = math.exp((1.0 - share) * logs[0] + share * logs[1]) - _UNSEEN
        mixed += octave * np.float32(deviation / (float(octave.std()) + 1e-6))
    if not ranked:
        return mixed
    quantiles = [np.quantile(plane, _QUANTILES) for plane in own]
    return by_rank(mixed, _QUANTILES, (1.0 - share) * quantiles[0] + share * quantiles[1])
