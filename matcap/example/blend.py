"""Multi-band blending across the seams of a rearranged exemplar [burt1983], and its normals."""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.stated import NormalStyle
from matcap.example.coordinates import Places
from matcap.example.exemplar import ROUGHNESS, Exemplar, Floats
from matcap.example.library import address, loops
from matcap.field.plane import RING, Period, Rectangle

if TYPE_CHECKING:
    from torch import Tensor

# Normals of a block from its heights, in NumPy; field/source.py has the same in PyTorch.


def with_normals(maps: Floats, texel_size: float, normal: NormalStyle) -> NDArray[np.float32]:
    """(9 or 11, h, w) maps and normal, of maps (6 or 8, h + 2 RING, w + 2 RING)."""
    height, size = maps[-1], np.float32(2.0 * texel_size)
    across = (height[RING:-RING, 2 * RING :] - height[RING:-RING, : -2 * RING]) / size
    up = (height[: -2 * RING, RING:-RING] - height[2 * RING :, RING:-RING]) / size
    upright = np.float32(1.0) / np.sqrt(np.float32(1.0) + across * across + up * up)
    planes = np.empty((len(maps) + 3, *across.shape), np.float32)
    planes[:-3] = maps[:, RING:-RING, RING:-RING]
    np.multiply(across, -upright, out=planes[-3])
    np.multiply(up, upright if normal == "dx" else -upright, out=planes[-2])
    planes[-1] = upright
    return planes


class ArraySource(ABC):
    """A source of a field whose stacked maps are computed in NumPy, on the processor."""

    device_type = "cpu"
    texel_size: float

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (6 or 8, height + 2 RING, width + 2 RING) of a block and its ring."""
        import torch

        return torch.from_numpy(self.around(block.grown(RING)))

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) maps and normal of a block."""
        return with_normals(self.around(block.grown(RING)), self.texel_size, normal)

    @abstractmethod
    def around(self, area: Rectangle) -> Floats:
        """Stacked maps (6 or 8, height, width) of any area."""


# Multi-band blending across the seams of a rearranged exemplar [burt1983].
#
# Each octave B_k of the exemplar's maps is blended over about its wavelength. Let place(q) be the
# exemplar's texel shown at texel q of the field. If the patch around q went on to texel p, p would
# show place(q) - q + p. In band k, texel p gets the weighted mean of these votes,
#
# V_k(p) = sum_q w_k(p - q) B_k(place(q) - q + p),
# map(p) = exemplar(place(p)) + sum_k (g_k V_k(p) - B_k(place(p))).
#
# Within a patch all votes are equal and p shows the exemplar to the last bit. Albedo and F0 are
# blended as logarithms. The mean of different votes has less variance than each; the gain
#
# g_k = 1 / sqrt(r_k + (1 - r_k) sum w^2)
#
# restores it, with r_k the correlation of different votes (seam_correlations). The height has no
# gain, which would amplify the slopes between patches.
#
# Votes are cast by nodes q on a grid of 2^k texels, with quadratic B-spline weights w_k: nine nodes
# a texel and band. The nodes' positions do not depend on the rectangle that is read, and sums have
# a fixed order, so that the bits do not either.
#
# Read next: kernel.c, coordinates.py.

# By band, finest first, level of the places that nodes read; docs/notes/field.md. Coarser levels
# save time for coarse bands; more bands blend slower drifts of colour.
BAND_LEVELS = (0, 0, 0, 0, 2, 3)
BANDS = len(BAND_LEVELS)

CHANNELS = 8  # of a band, as in kernel.c
NODES = 3  # nodes along an axis that vote for a texel
_DARKEST = 2.0**-10  # lower limit of albedo and F0 in logarithms


@dataclass(frozen=True)
class Band:
    """An octave of an exemplar's maps."""

    values: NDArray[np.int16]
    """(H, W, CHANNELS) int16, on a grid of 2^bits texels."""
    scale: Floats
    """(CHANNELS,) float32, unit of `values` in the map or in its log2."""
    bits: int
    """log2 of the grid's step."""


def bands_of(exemplar: Exemplar) -> tuple[Band, ...]:
    """Split an exemplar into bands, finest first; the last is the low-pass residual.

    Split by Gaussians of standard deviations of about 1.4, 3, 6.5, 13 and 26 texels.
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
    for band in range(1, BANDS):
        values = values[:: min(band, 2), :: min(band, 2)].copy()
        rows, columns = values.shape[:2]
        loops().matcap_smooth(address(values), address(np.empty_like(values)), columns, rows)
        smooth.append(values)
    shown = [smooth[0] - smooth[1]]
    shown += [fine - _doubled(coarse, fine) for fine, coarse in pairwise(smooth[1:])]
    return tuple(_quantised(band, max(0, k - 1)) for k, band in enumerate((*shown, smooth[-1])))


def seam_correlations(bands: Sequence[Band], places: Places, step: int) -> tuple[float, ...]:
    """Correlation r_k, in [0, 1], between the votes of adjacent patches, by band.

    Computed at the seams of a part of a field, from integers, so that it is the same on every
    machine. 1 for the last band, which is no texture.

    Args:
        places: (rows, columns, 2) of the field, `step` texels apart.
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
    """Linear interpolation to a grid twice as fine, of the shape of `fine`."""
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
    # By rows first: long vectors.
    most = np.maximum(values.max(axis=0).max(axis=0), -values.min(axis=0).min(axis=0))
    scale = np.maximum(most, np.float32(1e-9)) / np.float32(32767)
    return Band(np.rint(values / scale).astype(np.int16), scale, bits)


@dataclass(frozen=True)
class Nodes:
    """Nodes along one axis of an area."""

    at: NDArray[np.int64]
    """Positions of the nodes, texels of the plane."""
    first: NDArray[np.int32]
    """(length,) int32, index of the first of the NODES nodes that vote for a texel."""
    weights: Floats
    """(length, NODES) float32, of their votes."""

    @staticmethod
    def of(start: int, length: int, spacing: int, unit: int, period: int | None) -> Nodes:
        """Nodes that vote for the texels [start, start + length).

        Args:
            start, length: texels.
            spacing: of nodes, texels; with a period, the nearest that divides it.
            unit: nodes are at multiples of this, texels.
            period: texels, a multiple of the unit, or None.
        """
        whole, count = spacing, 1
        if period is not None:
            whole, count = period, max(1, (2 * period + spacing) // (2 * spacing))
        # Texel p is p * count / whole nodes from node 0, computed in integers.
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


@dataclass(frozen=True)
class Votes:
    """The nodes of a band for an area."""

    level: int
    """Level of the places that nodes read, which are 2^level grid steps apart."""
    bits: int
    """log2 of the step of the grid of places, texels."""
    across: Nodes
    down: Nodes
    """Nodes along columns and rows."""

    @staticmethod
    def of(band: int, area: Rectangle, period: Period | None, bits: int, levels: int) -> Votes:
        """Nodes of a band.

        Args:
            area: texels.
            period: of the field, or None.
            bits: log2 of the step of the grid of places, texels.
            levels: number of levels of places.
        """
        level = min(BAND_LEVELS[band], levels - 1)
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
        """The rectangle of places of the level that the nodes read."""
        shift = self.level + self.bits
        x, y = int(self.across.at[0]) >> shift, int(self.down.at[0]) >> shift
        right, bottom = int(self.across.at[-1]) >> shift, int(self.down.at[-1]) >> shift
        return Rectangle(x, y, right - x + 1, bottom - y + 1)

    def predicted(self, places: Places, area: Rectangle) -> NDArray[np.int32]:
        """(nodes down, nodes across, 2) int32: each node's vote for the area's texel (0, 0).

        A vote is x, y of the exemplar, place(q) - q + p.

        Args:
            places: of the `wanted` rectangle.
            area: texels.
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
        ("correlation", ctypes.c_float),
    )  # fmt: skip


class _Exemplar(ctypes.Structure):
    _fields_ = (
        ("planes", ctypes.c_void_p), ("places", ctypes.c_void_p),
        *((name, ctypes.c_int32) for name in (
            "channels", "columns", "place_columns", "bits", "left", "top",
        )),
    )  # fmt: skip


@dataclass(frozen=True)
class ExemplarBands:
    """An exemplar prepared for blending."""

    planes: tuple[Floats, ...]
    """(H, W) of each of its 6 or 8 stacked maps."""
    bands: tuple[Band, ...]
    """Bands on the grid of places."""
    correlations: tuple[float, ...]
    """r_k of every band."""
    bits: int
    """log2 of that grid's step, texels."""


def blended(
    shown: ExemplarBands,
    area: Rectangle,
    own: Places,
    votes: Sequence[tuple[Votes, NDArray[np.int32]]],
) -> Floats:
    """(6 or 8, height, width) stacked maps of an area, blended; see the module's equations.

    Args:
        area: in texels.
        own: places of the grid squares that the area overlaps.
        votes: nodes of every band, and Votes.predicted of them.

    Raises:
        MatcapError: the compiled loops are missing.
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
            band.bits + bits + 1, correlation,
        )
        for band, (of, predicted), correlation in zip(
            shown.bands, votes, shown.correlations, strict=True
        )
    ))  # fmt: skip
    joined = np.empty((channels, area.height, area.width), np.float32)
    loops().matcap_blend(
        ctypes.byref(exemplar), bands, len(bands), area.width, area.height, address(joined)
    )
    return joined
