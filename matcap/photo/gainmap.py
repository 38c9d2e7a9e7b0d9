"""Parses and evaluates a DNG's GainMap opcodes, lens shading (Adobe DNG 1.7.1, chapter 7).

raw.py applies them. Other opcodes are not applied; those that change more than single bad pixels
give a note.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_GAIN_MAP = 9  # an opcode (DNG 1.7, chapter 7)
# Other opcodes that change radiance or position, as text for notes.
_UNDONE = {
    **dict.fromkeys((1, 2, 14), "a lens distortion correction"),
    3: "a radial vignette correction",
    **dict.fromkeys((7, 8, 10, 11, 12, 13), "a correction of rows, columns or values"),
}
_HEADER = struct.Struct(">4I 4I 2I 4d I")
_MOST_POINTS = 1 << 24  # of a map; limits the memory that a file can claim


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


def parse_opcodes(data: bytes) -> tuple[tuple[GainMap, ...], frozenset[str]]:
    """Parse an OpcodeList: its gain maps, and names of other corrections that it has.

    Raises:
        ValueError: the bytes are not an opcode list.
    """
    try:
        (count,) = struct.unpack_from(">I", data)
        maps, undone, offset = [], set(), 4
        for _ in range(count):
            opcode, _version, _flags, size = struct.unpack_from(">4I", data, offset)
            payload = data[offset + 16 : offset + 16 + size]
            if opcode == _GAIN_MAP:
                maps.append(_parse_map(payload))
            if opcode in _UNDONE:
                undone.add(_UNDONE[opcode])
            offset += 16 + size
    except struct.error as error:
        raise ValueError("the opcode list is cut short") from error
    return tuple(maps), frozenset(undone)


def _parse_map(payload: bytes) -> GainMap:
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
