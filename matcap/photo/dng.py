"""DNG tags that LibRaw ignores: lens shading, white balance, colours (Adobe DNG 1.7.1)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.files.color import REC709_TO_D50
from matcap.files.containers import Tag
from matcap.photo.photo import decoding, unsupported
from matcap.photo.raw_samples import (
    JPEG_XL,
    VALUE_MAPS,
    Crop,
    ValueMap,
    crop_of,
    needs_normalising,
    unsupported_pattern,
    value_maps,
)

if TYPE_CHECKING:
    from tifffile import TiffPage


# Parses and evaluates a DNG's GainMap opcodes, lens shading (Adobe DNG 1.7.1, chapter 7).
#
# raw.py applies them. Other opcodes are not applied; those that change more than single bad pixels
# give a note.

_GAIN_MAP = 9  # an opcode (DNG 1.7, chapter 7)
_OF_VALUES = "a correction of values"
# Other opcodes that change radiance or position, as text for notes.
_UNDONE = {
    **dict.fromkeys((1, 2, 14), "a lens distortion correction"),
    3: "a radial vignette correction",
    **dict.fromkeys(VALUE_MAPS, _OF_VALUES),
    **dict.fromkeys((10, 11, 12, 13), "a correction of rows or columns"),
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


# Conversion of a DNG's camera colours to white-balanced Rec.709 (Adobe DNG 1.7.1, chapter 6).
#
# LibRaw uses AsShotNeutral and a single matrix. Here white is from AsShotNeutral or AsShotWhiteXY,
# by default D65; matrices are interpolated between the calibration illuminants by the white's
# colour temperature; CameraCalibration, AnalogBalance and ForwardMatrix are used. Third illuminants
# and reduction matrices are ignored.

Matrix = NDArray[np.float64]

_D65 = (0.3127, 0.3290)
# Linear Rec.709 to XYZ, D65 (IEC 61966-2-1).
_REC709_TO_XYZ = np.array(
    [
        [0.4123908, 0.3575843, 0.1804808],
        [0.2126390, 0.7151687, 0.0721923],
        [0.0193308, 0.1191948, 0.9505322],
    ]
)
_COLOR = (Tag.ColorMatrix1, Tag.ColorMatrix2)
_CALIBRATION = (Tag.CameraCalibration1, Tag.CameraCalibration2)
_FORWARD = (Tag.ForwardMatrix1, Tag.ForwardMatrix2)
_ILLUMINANTS = (Tag.CalibrationIlluminant1, Tag.CalibrationIlluminant2)
_SIGNATURES = (Tag.CameraCalibrationSignature, Tag.ProfileCalibrationSignature)
COLOR_TAGS = frozenset(
    {*_COLOR, *_CALIBRATION, *_FORWARD, *_ILLUMINANTS, *_SIGNATURES}
    | {Tag.AnalogBalance, Tag.AsShotNeutral, Tag.AsShotWhiteXY}
)
# Kelvin of Exif's LightSource, as Adobe's DNG SDK has them.
_KELVIN = {
    1: 5500.0, 2: 4150.0, 3: 2850.0, 4: 5500.0, 9: 5500.0, 10: 6500.0, 11: 7500.0, 12: 6400.0,
    13: 5050.0, 14: 4150.0, 15: 3525.0, 16: 2925.0, 17: 2850.0, 18: 5500.0, 19: 6500.0,
    20: 5500.0, 21: 6500.0, 22: 7500.0, 23: 5000.0, 24: 3200.0,
}  # fmt: skip
_ROUNDS = 30  # iterations of white_of


@dataclass(frozen=True)
class DngColor:
    """Conversion from a DNG's camera colours to Rec.709."""

    neutral: tuple[float, float, float]
    """(3,) camera colours of white; white balance divides by it."""
    matrix: Matrix
    """(3, 3) from white-balanced camera colours to linear Rec.709; rows sum to 1."""
    note: str = ""
    """Note to the user if the file states no neutral, or ""."""


def dng_color(tags: Mapping[int, Any]) -> DngColor | None:
    """Compute a DNG's conversion; None if it has no matrix for three colours.

    Args:
        tags: values by tag number; rationals as alternating numerators and denominators.

    Raises:
        ValueError, TypeError: the tags are invalid.
    """
    camera = _Camera.of(tags)
    if camera is None:
        return None
    neutral, white = _stated_neutral(tags), _stated_white(tags)
    note = ""
    if neutral is not None:
        white = camera.white_of(neutral)
    elif white is not None:
        neutral = camera.neutral_of(white)
        note = "White balance from the file's white point ({:.4f}, {:.4f}).".format(*white)
    else:
        white, neutral = _D65, camera.neutral_of(_D65)
        note = "The file states no white balance: daylight (D65) assumed."
    if not (np.isfinite(neutral).all() and neutral.min() > 1e-3 * neutral.max() > 0.0):
        raise ValueError("no white that a camera could see")
    red, green, blue = (neutral / neutral.max()).tolist()
    return DngColor((red, green, blue), camera.to_rec709(white, neutral), note)


@dataclass(frozen=True)
class _Camera:
    """Matrices for one or two calibration illuminants."""

    kelvin: tuple[float, ...]
    """Colour temperature of each illuminant."""
    color: tuple[Matrix, ...]
    """Matrices from XYZ to the reference camera, for each."""
    own: tuple[Matrix, ...]
    """Matrices from the reference camera to this one, AnalogBalance times CameraCalibration."""
    forward: tuple[Matrix, ...] | None
    """Matrices from the white-balanced reference camera to XYZ relative to D50, or None."""

    @staticmethod
    def of(tags: Mapping[int, Any]) -> _Camera | None:
        color = [_matrix(tags, tag) for tag in _COLOR]
        known = [_KELVIN.get(_whole(tags.get(tag)), 0.0) for tag in _ILLUMINANTS]
        # Two matrices are used only if both illuminants are known and differ.
        both = color[1] is not None and min(known) > 0.0 and known[0] != known[1]
        kept = [i for i in (0, 1) if color[i] is not None][: 2 if both else 1]
        if not kept:
            return None
        gains = _numbers(tags.get(Tag.AnalogBalance))
        balance = np.diag(gains) if len(gains) == 3 and gains.min() > 0.0 else np.eye(3)
        signatures = [_text(tags.get(tag)) for tag in _SIGNATURES]
        calibrations = [
            _matrix(tags, tag) if signatures[0] == signatures[1] else None for tag in _CALIBRATION
        ]
        own = [balance @ (np.eye(3) if c is None else c) for c in calibrations]
        forward = [_matrix(tags, tag) for tag in _FORWARD]
        whole = all(forward[i] is not None for i in kept)
        return _Camera(
            tuple(known[i] for i in kept),
            tuple(c for i in kept if (c := color[i]) is not None),
            tuple(own[i] for i in kept),
            tuple(f for i in kept if (f := forward[i]) is not None) if whole else None,
        )

    def neutral_of(self, white: tuple[float, float]) -> Matrix:
        """(3,) camera colours of a white (x, y)."""
        x, y = white
        return np.asarray(self._from_xyz(white) @ [x / y, 1.0, (1.0 - x - y) / y])

    def white_of(self, neutral: Matrix) -> tuple[float, float]:
        """White (x, y) of camera colours, iteratively, as the matrix depends on its temperature."""
        white = (0.3457, 0.3585)  # D50, the initial value in the specification
        for _ in range(_ROUNDS):
            x, y, z = np.linalg.solve(self._from_xyz(white), neutral)
            total = x + y + z
            if not total > 0.0 or not 0.0 < y / total < 1.0:
                return _D65
            estimate = (float(x / total), float(y / total))
            if abs(estimate[0] - white[0]) + abs(estimate[1] - white[1]) < 1e-7:
                return estimate
            # A half step, as full ones may oscillate.
            white = ((white[0] + estimate[0]) / 2.0, (white[1] + estimate[1]) / 2.0)
        return white

    def to_rec709(self, white: tuple[float, float], neutral: Matrix) -> Matrix:
        """(3, 3) from white-balanced camera colours to Rec.709; white is (1, 1, 1) in both."""
        own = self._mixed(self.own, white)
        if self.forward is not None:
            reference = np.linalg.solve(own, np.diag(neutral))
            reference /= reference.sum(axis=1, keepdims=True)
            to_d50 = self._mixed(self.forward, white) @ reference
            matrix = np.linalg.solve(REC709_TO_D50, to_d50)
        else:
            seen = own @ self._mixed(self.color, white) @ _REC709_TO_XYZ
            matrix = np.linalg.inv(seen / seen.sum(axis=1, keepdims=True))
        matrix /= matrix.sum(axis=1, keepdims=True)
        if not np.isfinite(matrix).all() or np.abs(matrix).max() > 50.0:
            raise ValueError("the colour matrices are no basis")
        return np.asarray(matrix, np.float64)

    def _from_xyz(self, white: tuple[float, float]) -> Matrix:
        return np.asarray(self._mixed(self.own, white) @ self._mixed(self.color, white))

    def _mixed(self, matrices: tuple[Matrix, ...], white: tuple[float, float]) -> Matrix:
        """Interpolation in inverse temperature between the illuminants, clamped to them."""
        if len(matrices) == 1:
            return matrices[0]
        first, second = (1.0 / kelvin for kelvin in self.kelvin)
        share = np.clip((1.0 / temperature(white) - second) / (first - second), 0.0, 1.0)
        return np.asarray(share * matrices[0] + (1.0 - share) * matrices[1])


def temperature(white: tuple[float, float]) -> float:
    """Correlated colour temperature of (x, y) in kelvin [mccamy1992], clamped to [1500, 50000]."""
    n = (white[0] - 0.3320) / (0.1858 - white[1])
    return float(np.clip(((449.0 * n + 3525.0) * n + 6823.3) * n + 5520.33, 1500.0, 50_000.0))


def _stated_neutral(tags: Mapping[int, Any]) -> Matrix | None:
    values = _numbers(tags.get(Tag.AsShotNeutral))
    return values if len(values) == 3 and values.min() > 0.0 else None


def _stated_white(tags: Mapping[int, Any]) -> tuple[float, float] | None:
    values = _numbers(tags.get(Tag.AsShotWhiteXY))
    if len(values) != 2 or values.min() < 0.05 or values.sum() > 0.95:
        return None
    return float(values[0]), float(values[1])


def _matrix(tags: Mapping[int, Any], tag: int) -> Matrix | None:
    values = _numbers(tags.get(tag))
    if len(values) != 9 or not values.any():
        return None
    return values.reshape(3, 3)


def _numbers(value: Any) -> Matrix:  # noqa: ANN401
    """Rationals as numbers; empty if absent or invalid."""
    parts = np.ravel(np.asarray(() if value is None else value, np.float64))
    if len(parts) % 2 or not len(parts) or not parts[1::2].all():
        return np.empty(0)
    return np.asarray(parts[0::2] / parts[1::2])


def _whole(value: Any) -> int:  # noqa: ANN401
    return -1 if value is None else int(np.ravel(value)[0])


def _text(value: Any) -> bytes:  # noqa: ANN401
    data = value.encode() if isinstance(value, str) else bytes(() if value is None else value)
    return data.rstrip(b"\0")


# Reads DNG tags that LibRaw ignores: lens shading, white balance, JPEG XL compression.

_CFA, _LINEAR_RAW = 32803, 34892  # photometric interpretations (DNG 1.7)
_FLOATING = 3  # a SampleFormat
_MOST_PAGES = 64  # a damaged file may claim any number of them


@dataclass(frozen=True)
class Corrections:
    """Corrections of a DNG that matcap applies itself."""

    on_mosaic: tuple[GainMap, ...] = ()
    """Gain maps of OpcodeList2, for linear samples before demosaicing."""
    after_demosaic: tuple[GainMap, ...] = ()
    """Gain maps of OpcodeList3."""
    rewritten: bool = False
    """Whether LibRaw cannot read the samples as they are stored (JPEG XL), or misreads them."""
    normalised: bool = False
    """Whether it misreads them (raw_samples.py)."""
    value_maps: tuple[ValueMap, ...] = ()
    """MapTable and MapPolynomial of OpcodeList2."""
    crop: Crop | None = None
    """Part of the active area that is the picture; None is all of it."""
    orientation: int | None = None
    """EXIF's orientation in the first directory, or None."""
    active_area: tuple[int, int, int, int] | None = None
    """Top, left, bottom, right (the last two excluded) of the area that gain maps refer to, in the
    stored picture; None is all of it."""
    color: DngColor | None = None
    """White balance and colour matrix, or None if the file has no matrix."""
    notes: tuple[str, ...] = ()
    """Notes on corrections that are not applied."""

    @property
    def has_maps(self) -> bool:
        """Whether there are gain maps."""
        return bool(self.on_mosaic or self.after_demosaic)


def read_corrections(path: Path) -> Corrections:
    """Read a DNG's opcode lists, colour tags and compression.

    Raises:
        MatcapError: the tags or the gain maps are damaged. Ignoring them would attribute lens
            shading to the light, or the light's colour to the material.
    """
    import tifffile

    with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
        page = raw_page(file)
        if page is None:
            return Corrections()
        pattern = unsupported_pattern(page)
        if pattern and int(page.photometric) == _CFA:
            raise unsupported(path, f"a DNG whose mosaic repeats by {pattern} photosites")
        on_mosaic, undone = parse_opcodes(_bytes(page, Tag.OpcodeList2))
        after, also_undone = parse_opcodes(_bytes(page, Tag.OpcodeList3))
        maps = value_maps(_bytes(page, Tag.OpcodeList2))
        asked = sorted((undone - {_OF_VALUES}) | also_undone)
        floating = int(page.sampleformat) == _FLOATING
        misread = not floating and needs_normalising(page, bool(maps))
        area = _active_area(page)
        crop = crop_of(
            page, {tag.code: tag for one in (file.pages.first, page) for tag in one.tags}
        )
        notes = [f"The DNG asks for {what}, which was not applied." for what in asked]
        if crop is not None and not crop.centred:
            notes.append(
                "The file's crop is off centre: the smallest part around the centre that holds it "
                "is read."
            )
        first = file.pages.first.tags.get(Tag.Orientation)
        return Corrections(
            on_mosaic,
            after,
            misread or int(page.compression) == JPEG_XL,
            misread,
            maps,
            crop,
            int(first.value) if first is not None and first.value in range(1, 9) else None,
            None if misread else area,
            dng_color(_values(page) | _values(file.pages.first)),
            tuple(notes),
        )


def raw_page(file: Any) -> TiffPage | None:  # noqa: ANN401
    """The largest raw picture of an open tifffile.TiffFile, or None."""
    pages = islice(_pages(file), _MOST_PAGES)
    raws = [page for page in pages if int(page.photometric) in (_CFA, _LINEAR_RAW)]
    return max(raws, key=lambda page: page.imagewidth * page.imagelength, default=None)


def _pages(file: Any) -> Iterator[Any]:  # noqa: ANN401
    for page in file.pages:
        yield page
        yield from page.pages or ()


def _values(page: Any) -> dict[int, Any]:  # noqa: ANN401
    return {tag.code: tag.value for tag in page.tags if tag.code in COLOR_TAGS}


def _active_area(page: Any) -> tuple[int, int, int, int] | None:  # noqa: ANN401
    if Tag.ActiveArea not in page.tags:
        return None
    top, left, bottom, right = (int(edge) for edge in page.tags[Tag.ActiveArea].value)
    if not (0 <= top < bottom <= page.imagelength and 0 <= left < right <= page.imagewidth):
        raise ValueError("the active area lies outside the picture")
    return top, left, bottom, right


def _bytes(page: Any, tag: int) -> bytes:  # noqa: ANN401
    """Bytes of an opcode list; of an empty one if the tag is absent."""
    return bytes(page.tags[tag].value) if tag in page.tags else bytes(4)
