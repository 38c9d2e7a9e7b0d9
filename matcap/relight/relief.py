"""The height field that displaces a surface, and its horizon maps [max1988]."""

from __future__ import annotations

import math
import mmap
from collections.abc import Iterator, Sequence
from contextlib import suppress
from ctypes import byref, c_int64, c_uint32
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Literal

import cv2
import numpy as np

from matcap.relight.camera import Array
from matcap.relight.loops.library import (
    AZIMUTHS,
    CHANNELS,
    LANES,
    CField,
    CHorizon,
    CWalk,
    KeptArrays,
    Pointer,
    Whole,
    address,
    loops,
)
from matcap.relight.texture import Texture

# The height field that displaces a surface: bilinear between texel centres.

# Offset of shadow rays above the surface, over the relief's height range, against rounding.
_LIFT = 2e-6
# clear_tangents bounds occluders by slope within _NEAR texels, by height in rings up to these.
_NEAR, _RINGS = 2, (5, 10, 20, 40)
_ROUNDING = 1.0 + 1e-5
# The mean albedo of a texel's neighbours is assumed to be at most _ADJACENT times the largest mean
# of _CELL x _CELL texels within a walk's reach (leather, knitted cloth, tiles: 99 % of texels below
# 0.94 to 1.16 times that mean), and at most the largest of all.
_CELL, _ADJACENT = 4, 1.75


@dataclass(frozen=True)
class Relief:
    """A texture's height, scaled to the surface it lies on."""

    texture: Texture
    """Maps of the material."""
    repeat: float
    """Factor by which the material is shrunk on the surface, heights included."""
    displacement: float
    """Factor on the heights."""
    endless: bool = True
    """Whether it repeats; else border heights are extended outwards, as opposite borders differ."""

    @cached_property
    def heights(self) -> Array:
        """(H W,) heights of the texels, scaled, in plane units."""
        factor = np.float32(self.displacement / self.repeat)
        return np.ascontiguousarray(self.texture.height[0] * factor).ravel()

    @cached_property
    def grid(self) -> Array:
        """(H, W) heights of the texels, scaled, in texels."""
        width, height = self.texture.size
        return self.heights.reshape(height, width) / np.float32(self.texel_size)

    @cached_property
    def low(self) -> float:
        """The lowest height."""
        return float(self.heights.min())

    @cached_property
    def high(self) -> float:
        """The highest height."""
        return float(self.heights.max())

    @property
    def texel_size(self) -> float:
        """A texel's side on the surface, in plane units."""
        return self.texture.texel_size / self.repeat

    def texels(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Columns and rows of places in plane units; texel centres are whole numbers."""
        width, height = self.texture.size
        return u / self.texel_size + (width - 1) / 2.0, (height - 1) / 2.0 - v / self.texel_size

    @cached_property
    def field(self) -> CField:
        """The C structure of the loops; valid while this object lives."""
        width, height = self.texture.size
        lift, ends = _LIFT * (self.high - self.low), int(not self.endless)
        return CField(
            self.heights.ctypes.data, width, height, ends, lift, self.high, self.low,
            self.texel_size,
        )  # fmt: skip

    @cached_property
    def bounded_field(self) -> CField:
        """`field` with clear_tangents: loops that cast many rays from a place skip clear ones."""
        c_field = CField.from_buffer_copy(self.field)
        c_field.clear = self.clear_tangents.ctypes.data
        return c_field

    def at(self, u: Array, v: Array) -> Array:
        """Heights at places (u, v) in plane units, float32."""
        kept, shape = KeptArrays(), np.broadcast_shapes(u.shape, v.shape)
        places = (np.broadcast_to(one, shape) for one in self.texels(u, v))
        heights = np.empty(shape, dtype=np.float32)
        loops().matcap_relight_heights(
            byref(self.field), c_int64(heights.size),
            *(Pointer(kept.of(one, np.float64)) for one in places), address(heights),
        )  # fmt: skip
        return heights

    @property
    def around(self) -> Literal["wrap", "edge"]:
        """Mode of np.pad that continues the heights beyond their border."""
        return "wrap" if self.endless else "edge"

    @cached_property
    def clear_tangents(self) -> Array:
        """(H W,) tangent of elevation above which no ray meets the surface, an upper bound.

        Valid for rays that start on the surface within half a texel of the texel's centre. Within
        _NEAR texels the bound is the steepest slope; in each ring beyond, the highest texel's
        height over the ring's inner radius.
        """
        wide = np.pad(self.grid, 1, mode=self.around)
        across, down = np.abs(np.diff(wide, axis=1)), np.abs(np.diff(wide, axis=0))
        # Steepest slope of each cell of four texels, then of the four cells around a texel.
        cells = np.hypot(np.maximum(across[:-1], across[1:]), np.maximum(down[:, :-1], down[:, 1:]))
        steep = np.maximum(cells[:-1], cells[1:])
        steep = np.maximum(steep[:, :-1], steep[:, 1:])
        lowest = self.grid - steep * np.float32(math.sqrt(0.5))
        upper = _highest(steep, _NEAR, self.around)
        nearest, peaks, covered = float(_NEAR), self.grid, 0
        for reach in _RINGS:
            peaks, covered = _highest(peaks, reach - covered, self.around), reach
            upper = np.maximum(upper, (peaks - lowest) / nearest)
            nearest = reach - 0.5
        highest = np.float32(self.high / self.texel_size)
        upper = np.maximum(upper, (highest - lowest) / nearest) * np.float32(_ROUNDING)
        return np.ascontiguousarray(upper, dtype=np.float32).ravel()

    def albedo_around(self, column: Array, row: Array) -> Array:
        """(3, N) largest mean albedo of the neighbours of places in texels, see _CELL."""
        (rows, columns), (width, height) = self.albedo_cells.shape[1:], self.texture.size
        if self.endless:
            row, column = np.mod(row, height), np.mod(column, width)
        i = (row * (rows / height)).astype(np.intp).clip(0, rows - 1)
        j = (column * (columns / width)).astype(np.intp).clip(0, columns - 1)
        return self.albedo_cells[:, i, j]

    @cached_property
    def albedo_cells(self) -> Array:
        """(3, rows, columns) of albedo_around()."""
        size = [max(1, side // _CELL) for side in self.texture.size]
        means = (
            cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in self.texture.diffuse
        )
        reach = -(-max(steps_of((self.high - self.low) / self.texel_size)) // _CELL) + 1
        peaks = [_highest(np.reshape(one, size[::-1]), reach, self.around) for one in means]
        largest = np.array(self.texture.brightest, dtype=np.float32)
        return np.minimum(np.float32(_ADJACENT) * np.stack(peaks), largest[:, None, None])

    def peaks(self, reach: int) -> Array:
        """(H W,) maximum of the heights over a square of 2 reach + 1 texels."""
        if reach not in self._peaks:
            width, height = self.texture.size
            self._peaks[reach] = _highest(
                self.heights.reshape(height, width), reach, self.around
            ).ravel()
        return self._peaks[reach]

    @cached_property
    def _peaks(self) -> dict[int, Array]:
        return {}


def _highest(field: Array, reach: int, mode: Literal["wrap", "edge"]) -> Array:
    """Maximum filter over a square of 2 reach + 1 texels (separable)."""
    for axis, size in enumerate(field.shape):
        if 2 * reach + 1 >= size:
            field = np.broadcast_to(field.max(axis=axis, keepdims=True), field.shape)
            continue
        around, kernel, cut = [(0, 0), (0, 0)], [1, 1], [slice(None), slice(None)]
        around[axis], kernel[axis], cut[axis] = (reach,) * 2, 2 * reach + 1, slice(reach, -reach)
        wide = np.pad(field, around, mode=mode)
        field = np.asarray(cv2.dilate(wide, np.ones(kernel, np.uint8)))[tuple(cut)]
    return np.ascontiguousarray(field)


# Horizon maps of a height field [max1988]: sky view factors, and transfer of one diffuse bounce.
#
# From each texel the height field is walked outwards along 16 azimuths, texel by texel up to eight,
# then in steps that grow by a fifth. The largest tangent of elevation so far is the horizon. Where
# a step raises it, the neighbour fills the strip of directions between old and new horizon; the
# strip's cosine-weighted solid angle is integrated in closed form. A ridge thinner than a step may
# be missed. Walks end at 256 texels, or where relief can hide less than 3 degrees.
#
# Texels are walked from on demand. Results depend on the material alone: they serve every light and
# every later picture.

_FARTHEST = 256  # texels
_LOWEST = math.tan(math.radians(3.0))
# Coarse transfer groups steps into ranges that end at these distances, in texels; the texel that
# raises the horizon most in a range stands for all of it. COARSENESS is the error assumed of that,
# over the largest transfer a texel may receive. Measured in 16,000 texels of captured leather, knit
# and tiles, 99 % are below 0.05, 0.12 and 0.11; with ranges that end at 2 and 8 texels below 0.05,
# 0.15 and 0.17, in 0.95 of the time; with eight azimuths below 0.12, 0.23 and 0.30. Tests compare
# pictures with those of all effects.
_PARTS = (2, 5, 12)
COARSENESS = 0.12
# (AZIMUTHS, 2) unit vectors, x right and y up: azimuth 0 is along x, turning towards y.
_AZIMUTH_VECTORS = np.array(
    [
        (math.cos(2.0 * math.pi * one / AZIMUTHS), math.sin(2.0 * math.pi * one / AZIMUTHS))
        for one in range(AZIMUTHS)
    ]
)


@dataclass(frozen=True, eq=False)
class _WalkState:
    """Walks of one precision: their parameters, which texels are done, and the results."""

    walk: CWalk
    """Parameters for the loops."""
    walked: Array
    """(H W,) uint8, 1 at the first texel of each group of LANES that is done."""
    transfer: Array | None
    """(H W, CHANNELS): for each colour the vector t with which neighbours, lit by irradiance e
    from direction l and none facing away from it, send the texel irradiance t . (e l); or None."""


class Horizons:
    """Horizon maps of a relief, computed on demand.

    Attributes:
        tangents: (H W, AZIMUTHS) tangent of the horizon's elevation; of no texel without `skies`.
        open: (H W, 2) sky view factor: irradiance of a uniform environment over that without
            relief but the same normal, [0, 1]; and cosine-weighted share of directions that meet
            relief, which times the largest albedo bounds the length of transfer vectors.
        shared: whether most pixels of the last block needed transfer: of the next, walks for
            `open` then compute it at once.
    """

    def __init__(self, relief: Relief, *, skies: bool = True) -> None:
        self.relief = relief
        size = len(relief.heights)
        self.tangents = _sparse(size if skies else 0, AZIMUTHS)
        self.open = _sparse(size, 2)
        self._marks = np.zeros(size, dtype=np.uint32)
        self._calls: Iterator[int] = count(1)
        self.shared = False

    def compute(self, column: Array, row: Array) -> None:
        """Fill `tangents` and `open` of the four texels around each place, in texels."""
        self._walk(self._plain, column, row, None)

    def transfer(self, column: Array, row: Array, which: Array | None, *, fine: bool) -> Array:
        """(H W, CHANNELS) transfer vectors, filled around places; fills what compute() does, too.

        Args:
            column, row: places, in texels.
            which: int32 indices of the places to fill around; None is all.
            fine: evaluate every step, or one neighbour for each range of _PARTS.
        """
        state = self._fine if fine else self._coarse
        self._walk(state, column, row, which)
        assert state.transfer is not None
        return state.transfer

    def as_c(self, *, adaptive: bool) -> CHorizon:
        """The horizons as a C structure (loops/library.py)."""
        width, height = self.relief.texture.size
        return CHorizon(self.tangents.ctypes.data, width, height, int(adaptive))

    def _walk(self, state: _WalkState, column: Array, row: Array, which: Array | None) -> None:
        width, height = self.relief.texture.size
        size = len(column) if which is None else len(which)
        texels, kept = np.empty(4 * size, dtype=np.int32), KeptArrays()
        some = None if which is None else kept.of(which, np.int32)
        library = loops()
        library.matcap_relight_unknown.restype = c_int64
        unknown = library.matcap_relight_unknown(
            Whole(width), Whole(height), address(state.walked), address(self._marks),
            c_uint32(next(self._calls)), c_int64(size), Pointer(some), address(column),
            address(row), address(texels),
        )  # fmt: skip
        if not unknown:
            return
        transfer = None if state.transfer is None else state.transfer.ctypes.data
        tangents = self.tangents.ctypes.data if self.tangents.size else None
        library.matcap_relight_walk(
            byref(state.walk), c_int64(unknown), address(texels),
            Pointer(tangents), address(self.open), Pointer(transfer),
        )  # fmt: skip
        state.walked[texels[:unknown]] = 1
        if state is not self._plain:
            self._plain.walked[texels[:unknown]] = 1

    def prepare(self, *, coarse: bool, fine: bool) -> None:
        """Allocate what threads share, before they start."""
        _ = self._plain, fine and self._fine
        _ = coarse and (self._coarse, self.relief.albedo_cells)

    @cached_property
    def _plain(self) -> _WalkState:
        return self._state(self._parts, transfers=False)

    @cached_property
    def _coarse(self) -> _WalkState:
        return self._state(self._parts, transfers=True)

    @cached_property
    def _fine(self) -> _WalkState:
        return self._state([[step] for step in self._steps], transfers=True)

    def _state(self, parts: Sequence[Sequence[int]], *, transfers: bool) -> _WalkState:
        moves, kept = _moves(np.array([step for part in parts for step in part])), KeptArrays()
        inverse = (1.0 / np.hypot(*moves)).astype(np.float32)
        ends = np.cumsum([len(part) for part in parts])
        nearest = [one.max() for one in np.split(inverse, ends[:-1], axis=1)]
        stride, size = self._padded.shape[1], len(self.open)
        walk = CWalk(
            kept.of(self._padded), kept.of(self._reflected) if transfers else None,
            kept.of(_AZIMUTH_VECTORS[:, 0]), kept.of(_AZIMUTH_VECTORS[:, 1]),
            kept.of(moves[1] * stride + moves[0], np.int32), kept.of(inverse),
            kept.of(ends, np.int32), kept.of(nearest), int(ends[-1]), len(parts),
            self.relief.texture.size[0], self._reach, stride, float(self._padded.max()),
        )  # fmt: skip
        transfer = _sparse(size, CHANNELS) if transfers else None
        return _WalkState(kept.kept_by(walk), np.zeros(size, dtype=np.uint8), transfer)

    @cached_property
    def _steps(self) -> list[int]:
        relief = self.relief
        return steps_of(float((relief.high - relief.low) / relief.texel_size))

    @cached_property
    def _parts(self) -> list[list[int]]:
        """The steps of each range of coarse transfer."""
        limits = (0, *_PARTS, max(self._reach, _PARTS[-1] + 1))
        parts = [
            [step for step in self._steps if low < step <= high]
            for low, high in zip(limits, limits[1:], strict=False)
        ]
        return [part for part in parts if part]

    @property
    def _reach(self) -> int:
        return max(self._steps)

    @cached_property
    def _padded(self) -> Array:
        """(rows, columns) heights in texels, padded by `_reach`."""
        return self._wrapped(self.relief.grid)

    def _wrapped(self, field: Array) -> Array:
        """A field padded by the longest step, and by a group of LANES on the right."""
        around = ((self._reach, self._reach), (self._reach, self._reach + LANES))
        return np.pad(field, around, mode=self.relief.around)

    @cached_property
    def _reflected(self) -> Array:
        """(rows, columns, CHANNELS) albedo / pi times normal, times the width of an azimuth.

        Its scalar product with (e l) is the radiance a texel sends under irradiance e from l.
        """
        wide = np.pad(self.relief.grid, 1, mode=self.relief.around)
        x = 0.5 * (wide[1:-1, 2:] - wide[1:-1, :-2])
        y = 0.5 * (wide[:-2, 1:-1] - wide[2:, 1:-1])
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        factor = np.float32(2.0 / AZIMUTHS)  # 1 / pi times 2 pi / AZIMUTHS
        normal = [self._wrapped(axis * factor) for axis in (-x * z, -y * z, z)]
        sent: Array = np.empty((*self._padded.shape, CHANNELS), dtype=np.float32)
        for channel, diffuse in enumerate(self.relief.texture.diffuse):
            albedo = self._wrapped(diffuse)
            for axis, component in enumerate(normal):
                np.multiply(albedo, component, out=sent[..., 3 * channel + axis])
        return sent


def _sparse(rows: int, columns: int) -> Array:
    """(rows, columns) float32 zeros, of which only the small pages that are written take memory.

    NumPy asks for huge ones, of which a scattered part of the texels writes most.
    """
    memory = mmap.mmap(-1, max(4 * rows * columns, 1))
    with suppress(AttributeError, OSError):  # Linux alone, if built with huge pages
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, np.float32, rows * columns).reshape(rows, columns)


def steps_of(rise: float) -> list[int]:
    """Distances of a walk's steps, in texels, for a field whose heights span `rise` texels."""
    last = min(max(1, math.ceil(rise / _LOWEST)), _FARTHEST)
    steps, step = [], 1
    while step <= last:
        steps.append(step)
        step = max(step + 1, round(step * 1.2)) if step >= 8 else step + 1
    return steps or [1]


def _moves(reach: Array) -> tuple[Array, Array]:
    """(AZIMUTHS, n) columns right and rows down of distances along each azimuth."""
    c, s = _AZIMUTH_VECTORS.T[..., None]
    return np.rint(c * reach).astype(np.int64), -np.rint(s * reach).astype(np.int64)
