"""Horizon maps of a height field: visible sky per texel, and one-bounce transfer.

From a texel, along 16 azimuths, the height field is walked outwards in growing steps (each texel
for the first eight, then a fifth more each time), and the highest elevation so far is kept
(horizon mapping: Max 1988). Whenever it rises, the strip of directions between the old elevation
and the new shows the neighbour: its share of what the texel receives is exact for the strip. A
ridge thinner than the step may be missed; steps stop where the relief could hide less than 3
degrees, and at 256 texels.

Texels are walked from when a picture asks for them, and what has been found is kept with the
material for the next picture: it is the same under every light.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from ctypes import byref, c_int64, c_uint32
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Literal, Protocol

import numpy as np

from matcap.relight.loops.library import (
    AZIMUTHS,
    CHANNELS,
    LANES,
    KeptArrays,
    Pointer,
    Whole,
    address,
    loops,
)
from matcap.relight.loops.structures import CHorizon, CWalk
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array

_FARTHEST = 256
_LOWEST = math.tan(math.radians(3.0))
# Of the distances in a coarse sum the last of each part, in texels: light is taken from the
# middle of a part. Its error as a share of what a texel may receive at most is taken to be
# COARSENESS: in 24,000 texels of simulated leather it is 0.15 or less in 99 of 100 and 0.30 in one,
# of an artist's bark 0.26 and 0.49 (with seven parts 0.12 and 0.27, 0.25 and 0.49, in 4 / 3 of the
# time: more is saved by finding fewer texels finely). Pictures are held to those of all effects.
_PARTS = (1, 3, 8, 20)
COARSENESS = 0.22
# (AZIMUTHS, 2) rightwards and upwards: azimuth 0 is along x, turning towards y.
_WAYS = np.array(
    [
        (math.cos(2.0 * math.pi * one / AZIMUTHS), math.sin(2.0 * math.pi * one / AZIMUTHS))
        for one in range(AZIMUTHS)
    ]
)


@dataclass(frozen=True, eq=False)
class _Known:
    """Of each texel, whether it was walked from, and how."""

    walk: CWalk
    """For the loops; distances come in parts of which each sends its light from one place."""
    kept: KeptArrays
    """What it points to."""
    walked: Array
    """(H W,) 1 at the first texel of each group that was walked from."""
    transfer: Array | None
    """(H W, CHANNELS) for each colour the vector t such that a neighbourhood lit by irradiance e
    along l sends the texel t . (e l), when none of it faces away from l; or None if not needed
    for it."""


class HeightField(Protocol):
    """What horizons must know of a relief (relief.py)."""

    @property
    def texture(self) -> Texture:
        """Its material."""
        ...

    @property
    def heights(self) -> Array:
        """(H W,) of its texels, as it lies on the surface."""
        ...

    @property
    def low(self) -> float:
        """The lowest of them."""
        ...

    @property
    def high(self) -> float:
        """The highest."""
        ...

    @property
    def texel_size(self) -> float:
        """A texel's side, in the heights' unit."""
        ...

    @property
    def around(self) -> Literal["wrap", "edge"]:
        """What np.pad puts around its texels."""
        ...


class Horizons:
    """Horizons of a relief, found as they are asked for.

    Attributes:
        tangents: (H W, AZIMUTHS) tangent of the horizon's elevation.
        open: (H W, 2) share of the light of an even sky that arrives, of what arrives above the
            plane on the same slope; and share of a diffuse texel's directions in which it sees
            neighbours: no transfer vector is longer than that times the largest albedo.
    """

    def __init__(self, relief: HeightField) -> None:
        self.relief = relief
        size = len(relief.heights)
        # Memory is taken where it is written to.
        self.tangents: Array = np.empty((size, AZIMUTHS), dtype=np.float32)
        self.open: Array = np.empty((size, 2), dtype=np.float32)
        self._marks = np.zeros(size, dtype=np.uint32)
        self._calls: Iterator[int] = count(1)

    def see(self, column: Array, row: Array) -> None:
        """Make `tangents` and `open` known around places, in texels."""
        self._walk(self._seen, column, row, None)

    def send(self, column: Array, row: Array, which: Array | None, *, fine: bool) -> Array:
        """(H W, CHANNELS) transfer vectors, known around some of the places; and as see().

        Args:
            column, row: places, in texels.
            which: int32 indices of the places; None is all.
            fine: each step on its own, or summed in parts.
        """
        known = self._fine if fine else self._coarse
        self._walk(known, column, row, which)
        assert known.transfer is not None
        return known.transfer

    def as_c(self, *, adaptive: bool) -> CHorizon:
        """As a C structure (loops/structures.py)."""
        width, height = self.relief.texture.size
        return CHorizon(self.tangents.ctypes.data, width, height, int(adaptive))

    def _walk(self, known: _Known, column: Array, row: Array, which: Array | None) -> None:
        width, height = self.relief.texture.size
        size = len(column) if which is None else len(which)
        texels, kept = np.empty(4 * size, dtype=np.int32), KeptArrays()
        some = None if which is None else kept.of(which, np.int32)
        library = loops()
        library.matcap_relight_unknown.restype = c_int64
        unknown = library.matcap_relight_unknown(
            Whole(width), Whole(height), address(known.walked), address(self._marks),
            c_uint32(next(self._calls)), c_int64(size), Pointer(some), address(column),
            address(row), address(texels),
        )  # fmt: skip
        if not unknown:
            return
        transfer = None if known.transfer is None else known.transfer.ctypes.data
        library.matcap_relight_walk(
            byref(known.walk), c_int64(unknown), address(texels),
            address(self.tangents), address(self.open), Pointer(transfer),
        )  # fmt: skip
        known.walked[texels[:unknown]] = 1
        if known is not self._seen:
            self._seen.walked[texels[:unknown]] = 1

    def prepare(self, *, sends: bool, fine: bool) -> None:
        """Make what all threads share, before they begin."""
        assert self._seen is not None
        if sends:
            assert self._coarse is not None
        if fine:
            assert self._fine is not None

    @cached_property
    def _seen(self) -> _Known:
        return self._known(self._parts, sends=False)

    @cached_property
    def _coarse(self) -> _Known:
        return self._known(self._parts, sends=True)

    @cached_property
    def _fine(self) -> _Known:
        return self._known([[step] for step in self._steps], sends=True)

    def _known(self, parts: Sequence[Sequence[int]], *, sends: bool) -> _Known:
        moves, kept = _moves(np.array([step for part in parts for step in part])), KeptArrays()
        inverse = (1.0 / np.hypot(*moves)).astype(np.float32)
        ends = np.cumsum([len(part) for part in parts])
        nearest = [one.max() for one in np.split(inverse, ends[:-1], axis=1)]
        middles = _moves(np.sqrt([float(part[0] * part[-1]) for part in parts]))
        stride, size = self._padded.shape[1], len(self.open)
        walk = CWalk(
            kept.of(self._padded), kept.of(self._lit) if sends else None,
            kept.of(_WAYS[:, 0]), kept.of(_WAYS[:, 1]),
            kept.of(moves[1] * stride + moves[0], np.int32),
            kept.of(middles[1] * stride + middles[0], np.int32), kept.of(inverse),
            kept.of(ends, np.int32), kept.of(nearest), self._padded.size, int(ends[-1]), len(parts),
            self.relief.texture.size[0], self._reach, stride, float(self._padded.max()),
        )  # fmt: skip
        transfer = np.empty((size, CHANNELS), dtype=np.float32) if sends else None
        return _Known(walk, kept, np.zeros(size, dtype=np.uint8), transfer)

    @cached_property
    def _steps(self) -> list[int]:
        relief = self.relief
        return steps_of(float((relief.high - relief.low) / relief.texel_size))

    @cached_property
    def _parts(self) -> list[list[int]]:
        """The steps, as they are summed together."""
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
        """(rows, columns) heights in texels with their repetition around."""
        width, height = self.relief.texture.size
        field: Array = self.relief.heights.reshape(height, width)
        return self._wrapped(field / np.float32(self.relief.texel_size))

    def _wrapped(self, field: Array) -> Array:
        """Texels with their repetition around, and a group's more on the right."""
        around = ((self._reach, self._reach), (self._reach, self._reach + LANES))
        return np.pad(field, around, mode=self.relief.around)

    @cached_property
    def _lit(self) -> Array:
        """(CHANNELS, rows, columns) what each texel reflects of light along x, y and z."""
        width, height = self.relief.texture.size
        field = self.relief.heights.reshape(height, width) / np.float32(self.relief.texel_size)
        wide = np.pad(field, 1, mode=self.relief.around)
        x = 0.5 * (wide[1:-1, 2:] - wide[1:-1, :-2])
        y = 0.5 * (wide[:-2, 1:-1] - wide[2:, 1:-1])
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        # albedo / pi, and the width of an azimuth.
        factor = np.float32(2.0 / AZIMUTHS)
        transfer: Array = np.empty((CHANNELS, *self._padded.shape), dtype=np.float32)
        for channel, albedo in enumerate(self.relief.texture.diffuse):
            for axis, component in enumerate((-x * z, -y * z, z)):
                transfer[3 * channel + axis] = self._wrapped(albedo * component * factor)
        return transfer


def steps_of(rise: float) -> list[int]:
    """Distances in texels at which the field is looked at; `rise` is its range in texels."""
    last = min(max(1, math.ceil(rise / _LOWEST)), _FARTHEST)
    steps, step = [], 1
    while step <= last:
        steps.append(step)
        step = max(step + 1, round(step * 1.2)) if step >= 8 else step + 1
    return steps or [1]


def _moves(reach: Array) -> tuple[Array, Array]:
    """Columns to the right and rows down, of distances along each azimuth."""
    c, s = _WAYS.T[..., None]
    return np.rint(c * reach).astype(np.int64), -np.rint(s * reach).astype(np.int64)
