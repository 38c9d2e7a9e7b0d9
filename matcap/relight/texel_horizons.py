"""Horizons of those parts of a material that are asked for, and of no others.

The same numbers as matcap.relight.horizons, which walks over the whole material: here parts of it
are taken as pixels ask for them, a walk ends where nothing further out is high enough to show, and
what neighbours reflect can be summed coarsely. What has been found is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from matcap.relight import compiled
from matcap.relight.horizons import AZIMUTHS, direction, lit_texels, slopes, steps_of, strip
from matcap.relight.relief import Relief
from matcap.relight.vectors import Array

# Rows and columns of texels walked together: their dozen arrays stay in a core's own cache.
_ROWS, _COLUMNS = 16, 512
# Of the distances in a coarse sum the last of each part, in texels: light is taken from the
# middle of a part. Its error as a share of what a texel may receive at most is taken to be
# COARSENESS: in 20,000 texels of simulated leather it is 0.07 or less in 99 of 100 and 0.18 in one
# (with parts up to 1, 3, 7 and 17 texels 0.11 and 0.35: a few pixels of a large picture showed it).
# Pictures are held to those of all effects.
_PARTS = (1, 2, 3, 5, 8, 12, 20)
COARSENESS = 0.12
# A step leads to a texel, which may be so much nearer than the step is long, in texels.
_ROUNDED = 0.7072
# A part of the material of which more than this share is asked for is walked over whole.
_MOST = 0.5


@dataclass(frozen=True)
class _Texels:
    """Texels that are walked together: a rectangle of them, or a list.

    Attributes:
        index: (N,) of each.
        place: rows and columns of the rectangle, None for a list.
        own: heights in texels, in whatever shape they are walked in.
        sx, sy: slopes rightwards and upwards.
        nz: of the normals.
        spot: (N,) where those of a list are in a padded field.
    """

    index: Array
    place: tuple[slice, slice] | None
    own: Array
    sx: Array
    sy: Array
    nz: Array
    spot: Array


class TexelHorizons:
    """Horizons of a relief, found as they are asked for.

    Attributes:
        tangents: (H W, AZIMUTHS), see Horizons.
        open: (H W, 2) share of an even sky that arrives, see Horizons; and share of a diffuse
            texel's directions in which it sees neighbours: no transfer vector is longer than
            that times the largest albedo.
    """

    def __init__(self, relief: Relief) -> None:
        self.relief = relief
        count = len(relief.heights)
        # Memory is taken where it is written to.
        self.tangents: Array = np.empty((count, AZIMUTHS), dtype=np.float32)
        self.open: Array = np.empty((count, 2), dtype=np.float32)
        self._steepest: Array = np.empty(count, dtype=np.float32)
        self._known: Array = np.zeros(count, dtype=bool)
        self._coarse: Array = np.empty((count, 9), dtype=np.float32)
        self._gathered: Array = np.zeros(count, dtype=bool)

    def see(self, texels: Array) -> None:
        """Make `tangents` and `open` known for texels, by their indices."""
        for some in self._fresh(texels, self._known):
            self._look(some)
            self._known[some.index] = True

    def steepest(self, texels: Array) -> Array:
        """The highest of each texel's tangents; they must be known."""
        return np.take(self._steepest, texels)

    def coarse(self, texels: Array) -> Array:
        """(H W, 9) what neighbours reflect, summed coarsely, known for some texels."""
        for some in self._fresh(texels, self._gathered):
            self._coarse[some.index] = self._gather(some, self._parts)
            self._gathered[some.index] = True
        return self._coarse

    def fine(self, texels: Array) -> Array:
        """(N, 9) the same for each of a list of texels, as Horizons has it."""
        return self._gather(self._list(texels), [[step] for step in self._steps])

    def _fresh(self, texels: Array, known: Array) -> Iterator[_Texels]:
        """Texels that are not known yet, each once; whole parts where most of them are wanted."""
        width, height = self.relief.texture.size
        unknown = np.unique(texels[~np.take(known, texels)])
        if len(unknown) and compiled.kernel() is None:
            across = -(-width // _COLUMNS)
            part = unknown // width // _ROWS * across + unknown % width // _COLUMNS
            dense = np.bincount(part) > _MOST * _ROWS * _COLUMNS
            for one in np.flatnonzero(dense).tolist():
                top, left = one // across * _ROWS, one % across * _COLUMNS
                yield self._rectangle(
                    top, min(top + _ROWS, height), left, min(left + _COLUMNS, width)
                )
            unknown = unknown[~dense[part]]
        for start in range(0, len(unknown), _ROWS * _COLUMNS):
            yield self._list(unknown[start : start + _ROWS * _COLUMNS])

    def _rectangle(self, top: int, bottom: int, left: int, right: int) -> _Texels:
        rows = np.arange(top, bottom)[:, None] * self.relief.texture.size[0]
        cut = (slice(top, bottom), slice(left, right))
        index = (rows + np.arange(left, right)).ravel()
        sx, sy, nz = (one[cut] for one in self._slopes)
        return _Texels(index, cut, self._field[cut], sx, sy, nz, index[:0])

    def _list(self, texels: Array) -> _Texels:
        own, sx, sy, nz = (np.take(one, texels) for one in (self._field, *self._slopes))
        row, column = np.divmod(texels, self.relief.texture.size[0])
        spot = (row + self._reach) * self._padded.shape[1] + column + self._reach
        return _Texels(texels, None, own, sx, sy, nz, spot)

    def _seen(self, some: _Texels, padded: Array, across: int, down: int) -> Array:
        """A padded field so far away from texels."""
        if some.place is not None:
            x, y = self._reach + across, self._reach + down
            rows, columns = some.place
            found: Array = padded[
                rows.start + y : rows.stop + y, columns.start + x : columns.stop + x
            ]
            return found
        return np.take(padded, some.spot + (down * padded.shape[1] + across))

    @cached_property
    def _steps(self) -> list[int]:
        relief = self.relief
        return steps_of(float((relief.high - relief.low) / relief.texel_size))

    @cached_property
    def _reach(self) -> int:
        return max(self._steps)

    @cached_property
    def _field(self) -> Array:
        width, height = self.relief.texture.size
        field: Array = self.relief.heights.reshape(height, width)
        return field / np.float32(self.relief.texel_size)

    @cached_property
    def _padded(self) -> Array:
        """The field in texels with its repetition around."""
        return np.pad(self._field, self._reach, mode="wrap")

    @cached_property
    def _slopes(self) -> tuple[Array, Array, Array]:
        """Slopes rightwards and upwards, and z of the normals."""
        sx, sy = slopes(self._field)
        return sx, sy, 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)

    @cached_property
    def _lit(self) -> list[Array]:
        """What each texel reflects, a colour after the other, padded."""
        return lit_texels(self.relief, self._reach)

    @cached_property
    def _highest(self) -> np.float32:
        return np.float32(self._field.max())

    @cached_property
    def _parts(self) -> list[list[int]]:
        """The steps, as they are summed together."""
        limits = (0, *_PARTS, max(self._reach, _PARTS[-1] + 1))
        parts = [
            [step for step in self._steps if low < step <= high]
            for low, high in zip(limits, limits[1:], strict=False)
        ]
        return [part for part in parts if part]

    @cached_property
    def _lit_rows(self) -> Array:
        """(rows, columns, 9) the same, beside each other for each texel."""
        return np.stack(self._lit, axis=-1)

    @cached_property
    def _seeing(self) -> compiled.HorizonSteps:
        return compiled.HorizonSteps(self._parts, self._padded, None, float(self._highest))

    @cached_property
    def _gathering(self) -> compiled.HorizonSteps:
        return replace(self._seeing, lit=self._lit_rows)

    @cached_property
    def _gathering_finely(self) -> compiled.HorizonSteps:
        return replace(self._gathering, parts=[[step] for step in self._steps])

    def _walk(
        self, some: _Texels, azimuth: int, parts: Sequence[Sequence[int]]
    ) -> Iterator[tuple[Array, Sequence[int]]]:
        """Horizons of texels along an azimuth, after none of the parts and after each of them.

        It ends where nothing further away is high enough to show. The array is the same each time.
        """
        c, s = direction(azimuth)
        level = np.float32(c) * some.sx + np.float32(s) * some.sy
        yield level, ()
        room = self._highest - some.own
        for part in parts:
            if not (room * np.float32(1.0 / (part[0] - _ROUNDED)) > level).any():
                return
            for step in part:
                across, down = round(step * c), -round(step * s)
                rise = self._seen(some, self._padded, across, down) - some.own
                rise *= np.float32(1.0 / math.hypot(across, down))
                np.maximum(level, rise, out=level)
            yield level, part

    def _look(self, some: _Texels) -> None:
        if compiled.kernel() is not None:
            tangents, found = compiled.look(
                self._seeing, some.spot, some.own, some.sx, some.sy, some.nz
            )
            self.tangents[some.index], self.open[some.index] = tangents, found
            self._steepest[some.index] = tangents.max(axis=-1)
            return
        seen, faced = np.zeros_like(some.own), np.zeros_like(some.own)
        tangents = np.empty((*some.own.shape, AZIMUTHS), dtype=np.float32)
        for azimuth in range(AZIMUTHS):
            walk = self._walk(some, azimuth, self._parts)
            level, _ = next(walk)
            side = -level * some.nz
            faced -= strip(level, side, some.nz)
            for _ in walk:
                pass
            tangents[..., azimuth] = level
            faced += strip(level, side, some.nz)
            np.maximum(level, np.float32(0.0), out=level)
            seen += side * np.float32(math.pi / 4.0) + some.nz * np.float32(0.5)
            seen -= strip(level, side, some.nz)
        seen *= np.float32(2.0 * math.pi / AZIMUTHS)
        share = np.clip(seen / (np.float32(math.pi / 2.0) * (1.0 + some.nz)), 0.0, 1.0)
        faced *= np.float32(2.0 / AZIMUTHS)
        self.tangents[some.index] = tangents.reshape(-1, AZIMUTHS)
        self._steepest[some.index] = tangents.max(axis=-1).ravel()
        self.open[some.index] = np.stack([share.ravel(), faced.ravel()], axis=1)

    def _gather(self, some: _Texels, parts: Sequence[Sequence[int]]) -> Array:
        """(N, 9) transfer vectors; light is taken from the middle of each part of the steps."""
        if compiled.kernel() is not None:
            steps = self._gathering if parts is self._parts else self._gathering_finely
            return compiled.gather(steps, some.spot, some.own, some.sx, some.sy, some.nz)
        total = np.zeros((9, *some.own.shape), dtype=np.float32)
        for azimuth in range(AZIMUTHS):
            c, s = direction(azimuth)
            walk = self._walk(some, azimuth, parts)
            level, _ = next(walk)
            side = -level * some.nz
            weight = strip(level, side, some.nz)
            for level, part in walk:
                higher = strip(level, side, some.nz)
                share = higher - weight
                weight = higher
                middle = math.sqrt(part[0] * part[-1])
                across, down = round(middle * c), -round(middle * s)
                for one, lit in zip(total, self._lit, strict=True):
                    one += share * self._seen(some, lit, across, down)
        return total.reshape(9, -1).T
