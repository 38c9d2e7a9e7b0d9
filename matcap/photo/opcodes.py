"""Opcodes of a DNG's raw picture: GainMap, which is lens shading, MapTable and MapPolynomial.

Adobe DNG 1.7.1, chapter 7. raw.py applies gain maps, raw_samples.py maps of values. Other opcodes
are not applied; those that change more than single bad pixels give a note.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MAP_TABLE, _MAP_POLYNOMIAL, _GAIN_MAP = 7, 8, 9
_VALUE_MAPS = (_MAP_TABLE, _MAP_POLYNOMIAL)
VALUE_MAPPING = "a correction of values"
# Opcodes that change radiance or position, as text for notes; a GainMap is always applied.
_CHANGES = {
    **dict.fromkeys((1, 2, 14), "a lens distortion correction"),
    3: "a radial vignette correction",
    **dict.fromkeys(_VALUE_MAPS, VALUE_MAPPING),
    **dict.fromkeys((10, 11, 12, 13), "a correction of rows or columns"),
}
_HEADER = struct.Struct(">4I 4I 2I 4d I")  # of a GainMap
_AREA = struct.Struct(">8I I")  # area, plane, planes, pitch; then the number of entries or degree
_HIGHEST_DEGREE = 8  # of a MapPolynomial
_MOST_POINTS = 1 << 24  # of a GainMap; limits the memory that a file can claim


@dataclass(frozen=True)
class GainMap:
    """Gains on a coarse grid over the active area."""

    area: tuple[int, int, int, int]
    """Top, left, bottom, right of the pixels it applies to; the last two excluded."""
    planes: tuple[int, int]
    """First plane it applies to, and the plane after the last."""
    pitch: tuple[int, int]
    """Applies to every pitch-th row and column of the area."""
    spacing: tuple[float, float]
    origin: tuple[float, float]
    """Spacing and origin of the grid (vertical, horizontal), in sides of the active area."""
    gains: NDArray[np.float32]
    """(V, H, P) float32; planes beyond P use the last."""

    def at(
        self, rows: NDArray[np.float64], columns: NDArray[np.float64], plane: int
    ) -> NDArray[np.float32]:
        """(R, C) bilinear gains at relative positions in [0, 1], clamped to the grid."""
        grid = self.gains[..., min(plane - self.planes[0], self.gains.shape[2] - 1)]
        down = _weights(rows, self.gains.shape[0], self.spacing[0], self.origin[0])
        across = _weights(columns, self.gains.shape[1], self.spacing[1], self.origin[1])
        return np.asarray(down @ grid @ across.T, np.float32)


@dataclass(frozen=True)
class Shading:
    """All gain maps of one opcode list, for a picture that shows a part of the active area."""

    maps: tuple[GainMap, ...]
    """Gain maps, in coordinates of the active area."""
    active: tuple[int, int]
    """(height, width) of the active area."""
    size: tuple[int, int]
    """(height, width) of the picture."""
    offset: tuple[int, int] = (0, 0)
    """(row, column) of the picture's first pixel in the active area."""

    def gains(self, top: int, bottom: int, planes: int) -> NDArray[np.float32]:
        """(n, W, planes) gains for the picture's rows [top, bottom)."""
        total = np.ones((bottom - top, self.size[1], planes), np.float32)
        for gain_map in self.maps:
            rows, down = self._touched(gain_map, np.arange(top, bottom), 0)
            columns, across = self._touched(gain_map, np.arange(self.size[1]), 1)
            place = np.ix_(rows, columns)
            for plane in range(gain_map.planes[0], min(gain_map.planes[1], planes)):
                total[..., plane][place] *= gain_map.at(down, across, plane)
        return total

    def largest(self, planes: int) -> float:
        """The largest gain, at least 1."""
        step = 256
        strips = ((top, min(top + step, self.size[0])) for top in range(0, self.size[0], step))
        return max(1.0, *(float(self.gains(*strip, planes).max()) for strip in strips))

    def _touched(
        self, gain_map: GainMap, pixels: NDArray[np.intp], axis: int
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Mask of rows (axis 0) or columns that a map applies to, and their relative positions."""
        first, last = gain_map.area[axis], gain_map.area[axis + 2]
        sites = pixels + self.offset[axis]
        on_pitch = (sites - first) % gain_map.pitch[axis] == 0
        inside = (sites >= first) & (sites < last) & on_pitch
        return inside, (sites[inside] + 0.5) / self.active[axis]


@dataclass(frozen=True)
class ValueMap:
    """A MapTable or MapPolynomial opcode (DNG 1.7.1, chapter 7)."""

    area: tuple[int, int, int, int]
    """Top, left, bottom, right; the last two excluded."""
    planes: tuple[int, int]
    """First plane, and number of planes."""
    pitch: tuple[int, int]
    """Rows and columns between the samples that it applies to."""
    numbers: NDArray[np.float64]
    """Values in [0, 1] of a table, or coefficients of a polynomial."""
    is_table: bool
    """Whether it is a table."""

    def apply(self, samples: NDArray[np.float32]) -> None:
        """Map normalised samples (H, W, C) in place, clipped to [0, 1]."""
        top, left, bottom, right = self.area
        first, count = self.planes
        down, across = self.pitch
        place = np.s_[top:bottom:down, left:right:across, first : first + count]
        inside = np.clip(samples[place], 0.0, 1.0).astype(np.float64)
        if self.is_table:
            last = len(self.numbers) - 1
            mapped: Any = np.interp(inside * 65535.0, np.arange(last + 1), self.numbers)
        else:
            mapped = np.polynomial.polynomial.polyval(inside, self.numbers)
        samples[place] = np.clip(mapped, 0.0, 1.0)


@dataclass(frozen=True)
class Opcodes:
    """The opcodes of a list, in order."""

    gain_maps: tuple[GainMap, ...] = ()
    """Lens shading."""
    value_maps: tuple[ValueMap, ...] = ()
    """MapTable and MapPolynomial."""
    changes: frozenset[str] = frozenset()
    """Names of all other corrections, and VALUE_MAPPING."""


def parse_opcodes(data: bytes) -> Opcodes:
    """Parse an OpcodeList.

    Raises:
        ValueError: the bytes are not an opcode list.
    """
    gain_maps, value_maps, changes, offset = [], [], set(), 4
    try:
        (count,) = struct.unpack_from(">I", data)
        for _ in range(count):
            opcode, _version, _flags, size = struct.unpack_from(">4I", data, offset)
            payload = data[offset + 16 : offset + 16 + size]
            if opcode == _GAIN_MAP:
                gain_maps.append(_gain_map(payload))
            if opcode in _VALUE_MAPS:
                value_maps.append(_value_map(opcode, payload))
            if opcode in _CHANGES:
                changes.add(_CHANGES[opcode])
            offset += 16 + size
    except struct.error as error:
        raise ValueError("the opcode list is cut short") from error
    return Opcodes(tuple(gain_maps), tuple(value_maps), frozenset(changes))


def _gain_map(payload: bytes) -> GainMap:
    numbers = _HEADER.unpack_from(payload)
    area, (plane, planes, *pitch) = numbers[:4], numbers[4:8]
    points, spacing, origin, depth = numbers[8:10], numbers[10:12], numbers[12:14], numbers[14]
    count = points[0] * points[1] * depth
    if not 0 < count <= _MOST_POINTS or len(payload) < _HEADER.size + 4 * count:
        raise ValueError("a gain map is cut short")
    gains = np.frombuffer(payload, ">f4", count, _HEADER.size).astype(np.float32)
    if min(pitch) < 1 or not (np.isfinite(gains).all() and gains.min() > 0.0):
        raise ValueError("a gain map has invalid numbers")
    if not all(np.isfinite(spacing)) or not all(np.isfinite(origin)):
        raise ValueError("a gain map has an invalid grid")
    return GainMap(
        area,
        (plane, plane + planes),
        (pitch[0], pitch[1]),
        spacing,
        origin,
        gains.reshape(*points, depth),
    )


def _weights(
    positions: NDArray[np.float64], points: int, spacing: float, origin: float
) -> NDArray[np.float32]:
    """(positions, points) matrix of linear interpolation, clamped at the ends."""
    if points == 1 or spacing <= 0.0:
        weights = np.zeros((positions.size, points), np.float32)
        weights[:, 0] = 1.0
        return weights
    place = np.clip((positions - origin) / spacing, 0.0, points - 1.0)
    distance = np.abs(place[:, None] - np.arange(points))
    return np.maximum(1.0 - distance, 0.0).astype(np.float32)


def _value_map(opcode: int, payload: bytes) -> ValueMap:
    *head, count = _AREA.unpack_from(payload)
    is_table = opcode == _MAP_TABLE
    if not is_table and count > _HIGHEST_DEGREE:
        raise ValueError("a polynomial of too high a degree")
    entries = count if is_table else count + 1
    kind = ">u2" if is_table else ">f8"
    if len(payload) < _AREA.size + entries * np.dtype(kind).itemsize or entries < 1:
        raise ValueError("a map of values is cut short")
    numbers = np.frombuffer(payload, kind, entries, _AREA.size).astype(np.float64)
    if not np.isfinite(numbers).all() or min(head[6:8]) < 1:
        raise ValueError("a map of values has invalid numbers")
    area = (head[0], head[1], head[2], head[3])
    return ValueMap(
        area,
        (head[4], head[5]),
        (head[6], head[7]),
        numbers / 65535.0 if is_table else numbers,
        is_table,
    )
