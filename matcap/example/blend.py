"""Multi-band blending across the seams of a rearranged exemplar.

A patch that ends at a seam ends in every octave at once: grain, colour and height step there. So
each octave of every map is blended over about as many texels as its waves are long (Burt and
Adelson 1983). A texel p reads, in band k, the weighted mean of what the texels around it predict,

    V_k(p) = sum_q w_k(p - q) B_k(place(q) - q + p),

B_k the exemplar's band, w_k a window of about two of its grid's steps. With one patch around p
every prediction is the texel's own, and p shows the exemplar to the last bit; elsewhere

    map(p) = exemplar(place(p)) + sum_k (g_k V_k(p) - B_k(place(p))),

so that the exemplar's own numbers are read wherever bands add nothing. Albedo and F0 are added up
as logarithms. A mean of votes that differ has less variance than each; g_k restores it,
1 / sqrt(r + (1 - r) sum w^2), r how far votes that differ correlate. Not that of the height, whose
slopes show: those where one piece passes into another are added to its own.

Votes are taken at nodes 2^k texels apart (`Votes`), weighted by a quadratic B-spline, so that
a texel reads nine a band. Nodes lie where they do whatever rectangle is read, and the loop adds up
in one order: the same bits.

Read next: kernel.c, coordinates.py.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.example.correction import Places
from matcap.example.exemplar import ROUGHNESS, Exemplar, Floats
from matcap.example.library import address, loops
from matcap.example.tuned import BLEND
from matcap.field.plane import Period, Rectangle

CHANNELS = 8  # of a texel in bands, as in kernel.c
NODES = 3  # along an axis that vote for a texel
_DARKEST = 2.0**-10  # albedo and F0: what is darker is as dark


@dataclass(frozen=True)
class Band:
    """An octave of an exemplar's maps.

    Attributes:
        values: (H, W, CHANNELS) int16 on a grid 2^bits texels wide.
        scale: (CHANNELS,) float32: what one of `values` is of the map, or of its log2.
        bits: of the grid.
    """

    values: NDArray[np.int16]
    scale: Floats
    bits: int


def bands_of(exemplar: Exemplar) -> tuple[Band, ...]:
    """An exemplar's bands, split at about 1.4, 3, 6.5, 13 and 26 texels (deviations of a Gaussian);
    the finest first, the last is all that is coarser.
    """
    maps = exemplar.stacked()
    _, rows, columns = maps.shape
    values = np.zeros((rows, columns, CHANNELS), np.float32)
    for channel, plane in enumerate(maps):
        logs = channel < len(maps) + (ROUGHNESS.start or 0)
        # Rounded from float64, so that it is the same on every machine.
        shown = np.log2(np.maximum(plane, _DARKEST), dtype=np.float64) if logs else plane
        values[..., channel] = shown - shown.mean(dtype=np.float64)
    smooth = [values]
    for band in range(1, BLEND.bands):
        values = values[:: min(band, 2), :: min(band, 2)].copy()
        rows, columns = values.shape[:2]
        loops().matcap_smooth(address(values), address(np.empty_like(values)), columns, rows)
        smooth.append(values)
    shown = [smooth[0] - smooth[1]]
    shown += [fine - _doubled(coarse, fine) for fine, coarse in pairwise(smooth[1:])]
    return tuple(_quantised(band, max(0, k - 1)) for k, band in enumerate((*shown, smooth[-1])))


def alike_at_seams(bands: Sequence[Band], places: Places, step: int) -> tuple[float, ...]:
    """Of every band: how far what two places predict of a texel correlates where they meet.

    Sums are of integers, and so the same on every machine. Of the last band as if wholly: what it
    holds is no texture whose contrast could be lost.

    Args:
        bands: of an exemplar.
        places: (rows, columns, 2) of a field, `step` texels apart.
        step: texels.
    """
    at = places.astype(np.int64)
    pairs = []
    for axis, offset in ((1, (step, 0)), (0, (0, step))):
        one, other = (at.take(range(k, at.shape[axis] - 1 + k), axis) for k in (0, 1))
        seams = (other - one != offset).any(axis=-1)
        pairs.append((one[seams], other[seams] - offset))
    first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    return (*(_correlation(band, first, second) for band in bands[:-1]), 1.0)


def _correlation(band: Band, first: NDArray[np.int64], second: NDArray[np.int64]) -> float:
    rows, columns = band.values.shape[:2]

    def read(places: NDArray[np.int64]) -> NDArray[np.int64]:
        x, y = (places >> band.bits).clip(0, (columns - 1, rows - 1)).T
        return band.values[y, x].astype(np.int64)

    one, other = read(first), read(second)
    products, powers = (one * other).sum(axis=0), (one * one).sum(axis=0) * 1.0
    powers *= (other * other).sum(axis=0)
    some = powers > 0.0
    if not some.any():
        return 1.0
    return float((products[some] / np.sqrt(powers[some])).mean().clip(0.0, 1.0))


def _doubled(coarse: Floats, fine: Floats) -> Floats:
    """Values on a grid twice as fine, by lines between them."""
    for axis in (0, 1):
        count = fine.shape[axis]
        after = np.minimum(np.arange(count // 2) + 1, coarse.shape[axis] - 1)
        ahead = coarse.take(after, axis)
        shape = list(coarse.shape)
        shape[axis] = count
        doubled = np.empty(shape, np.float32)
        along = (slice(None),) * axis
        doubled[(*along, slice(0, None, 2))] = coarse
        between = coarse[(*along, slice(0, count // 2))]
        doubled[(*along, slice(1, None, 2))] = (between + ahead) * np.float32(0.5)
        coarse = doubled
    return coarse


def _quantised(values: Floats, bits: int) -> Band:
    most = np.maximum(values.max(axis=(0, 1)), -values.min(axis=(0, 1)))
    scale = np.maximum(most, np.float32(1e-9)) / np.float32(32767)
    return Band(np.rint(values / scale).astype(np.int16), scale, bits)


@dataclass(frozen=True)
class Nodes:
    """Nodes along columns or rows of an area.

    Attributes:
        at: where each node lies, in texels of the plane.
        first: (length,) int32: the first of the NODES nodes that vote for a texel.
        weights: (length, NODES) float32 of their votes.
    """

    at: NDArray[np.int64]
    first: NDArray[np.int32]
    weights: Floats

    @staticmethod
    def of(start: int, length: int, spacing: int, unit: int, period: int | None) -> Nodes:
        """Nodes for `length` texels from `start` on.

        Args:
            start, length: texels.
            spacing: between nodes; where there is a period, about as much, a whole number of times.
            unit: nodes lie at multiples of it.
            period: in texels, a multiple of the unit.
        """
        whole, count = (spacing, 1) if period is None else (period, _times(period, spacing))
        # A texel at p lies p * count / whole nodes from that at 0; exactly, whatever the size.
        begin, rest = divmod(2 * start * count + whole, 2 * whole)
        steps = rest + 2 * count * np.arange(length)
        nearest = steps // (2 * whole)
        fraction = (steps % (2 * whole)) / (2 * whole) - 0.5
        numbers = range(begin - 1, begin + int(nearest[-1]) + 2)
        at = np.array([j * whole // count // unit * unit for j in numbers], np.int64)
        weights = np.stack(
            [0.5 * (0.5 - fraction) ** 2, 0.75 - fraction**2, 0.5 * (0.5 + fraction) ** 2], axis=-1
        )
        return Nodes(at, nearest.astype(np.int32), weights.astype(np.float32))


def _times(period: int, spacing: int) -> int:
    return max(1, (2 * period + spacing) // (2 * spacing))


@dataclass(frozen=True)
class Votes:
    """The nodes of a band for an area.

    Attributes:
        level: of places, 2^level texels of the grid of places apart, that nodes are read from.
        bits: the grid of places is 2^bits texels wide.
        across, down: nodes along columns and rows.
    """

    level: int
    bits: int
    across: Nodes
    down: Nodes

    @staticmethod
    def of(band: int, area: Rectangle, period: Period | None, bits: int, levels: int) -> Votes:
        """Those of a band.

        Args:
            band: its number, from 0.
            area: in texels.
            period: that the field repeats in.
            bits: the grid of places is 2^bits texels wide.
            levels: of places that there are.
        """
        level = min(BLEND.levels[band], levels - 1)
        spacing, unit = 1 << (band + bits), 1 << (level + bits)
        along_x, along_y = period or (None, None)
        return Votes(
            level,
            bits,
            Nodes.of(area.x, area.width, spacing, unit, along_x),
            Nodes.of(area.y, area.height, spacing, unit, along_y),
        )

    @property
    def wanted(self) -> Rectangle:
        """The places of the level that nodes are among."""
        shift = self.level + self.bits
        x, y = int(self.across.at[0]) >> shift, int(self.down.at[0]) >> shift
        right, bottom = int(self.across.at[-1]) >> shift, int(self.down.at[-1]) >> shift
        return Rectangle(x, y, right - x + 1, bottom - y + 1)

    def predicted(self, places: Places, area: Rectangle) -> NDArray[np.int32]:
        """(nodes down, nodes across, 2) int32: x, y of the exemplar that an area's texel (0, 0) is
        predicted to show by each node, of the places that are wanted.
        """
        shift, x, y = self.level + self.bits, self.across.at, self.down.at
        columns, rows = (x >> shift) - self.wanted.x, (y >> shift) - self.wanted.y
        seen_at = places[np.ix_(rows, columns)].astype(np.int32) << self.bits
        seen_at[..., 0] -= (x - area.x).astype(np.int32)
        seen_at[..., 1] -= (y - area.y).astype(np.int32)[:, None]
        return seen_at


class _Band(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in (
            "values", "scale", "kept", "offsets", "first_column", "first_row",
            "column_weights", "row_weights",
        )),
        *((name, ctypes.c_int32) for name in ("columns", "rows", "node_columns", "shift")),
        ("alike", ctypes.c_float),
    )  # fmt: skip


class _Exemplar(ctypes.Structure):
    _fields_ = (
        ("planes", ctypes.c_void_p), ("places", ctypes.c_void_p),
        *((name, ctypes.c_int32) for name in (
            "channels", "columns", "place_columns", "bits", "left", "top",
        )),
    )  # fmt: skip


@dataclass(frozen=True)
class Shown:
    """What an exemplar shows.

    Attributes:
        planes: (H, W) of each of its 6 or 8 stacked maps.
        bands: of them, on the grid of places.
        alike: of every band: how far votes that differ correlate.
        bits: that grid is 2^bits texels wide.
    """

    planes: tuple[Floats, ...]
    bands: tuple[Band, ...]
    alike: tuple[float, ...]
    bits: int


def blended(
    shown: Shown,
    area: Rectangle,
    own: Places,
    votes: Sequence[tuple[Votes, NDArray[np.int32]]],
) -> Floats:
    """(6 or 8, height, width) stacked maps of an area.

    Args:
        shown: the exemplar.
        area: in texels.
        own: places of the squares of 2^bits texels that the area has a part of.
        votes: of every band: its nodes, and what they predict.

    Raises:
        MatcapError: the loops were not built.
    """
    channels, columns = len(shown.planes), shown.planes[0].shape[1]
    bits, mask = shown.bits, (1 << shown.bits) - 1
    own = np.ascontiguousarray(own)
    planes = (ctypes.c_void_p * channels)(*(address(plane) for plane in shown.planes))
    exemplar = _Exemplar(
        ctypes.addressof(planes), own.ctypes.data, channels, columns, own.shape[1], bits,
        area.x & mask, area.y & mask,
    )  # fmt: skip
    kept: list[NDArray[Any]] = []

    def keep(array: NDArray[Any]) -> int:
        kept.append(np.ascontiguousarray(array))
        return kept[-1].ctypes.data

    keeps = np.ones(CHANNELS, np.float32)
    keeps[channels - 1] = 0.0
    bands = (_Band * len(votes))(*(
        _Band(
            keep(band.values), keep(band.scale), keep(keeps), keep(predicted),
            keep(of.across.first), keep(of.down.first),
            keep(of.across.weights), keep(of.down.weights),
            band.values.shape[1], band.values.shape[0], predicted.shape[1],
            band.bits + bits + 1, alike,
        )
        for band, (of, predicted), alike in zip(shown.bands, votes, shown.alike, strict=True)
    ))  # fmt: skip
    joined = np.empty((channels, area.height, area.width), np.float32)
    loops().matcap_blend(
        ctypes.byref(exemplar), bands, len(bands), area.width, area.height, address(joined)
    )
    return joined
